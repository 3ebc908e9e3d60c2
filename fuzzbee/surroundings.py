"""What the environment of the command may change of what it runs, and what not."""

import os

# numba's own switches are for whoever develops with it: some print on standard output, others make
# code that takes minutes, or none. These are ours to read; for any CPU is what containers say.
MEANT = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT", "NUMBA_CPU_NAME=generic")


def settle_environment() -> str | None:
    """Take away what is meant for other programs; returns a line that names it, if there was any.

    What Python starts for us looks for no modules in the current folder.
    """
    os.environ["PYTHONSAFEPATH"] = "1"
    taken = [
        name
        for name, value in os.environ.items()
        if name.startswith("NUMBA_") and name not in MEANT and f"{name}={value}" not in MEANT
    ]
    for name in taken:
        del os.environ[name]
    return f"{', '.join(sorted(taken))}: not used by fuzzbee" if taken else None
