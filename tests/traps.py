"""A folder as somebody else may leave it: programs under the names that we import."""

PACKAGES = ("estimator", "drivers", "service", "tuning", "fuzzbee")
MODULES = ("numba", "numpy", "llvmlite", "typer", "rich", "msgspec", "zenoh", "sitecustomize")


def set_trap(folder):
    """Whatever of it is run writes its own path into ``folder/sprung``."""
    spring = f"open({str(folder / 'sprung')!r}, 'a').write(__file__ + '\\n')\n"
    for package in PACKAGES:
        (folder / package).mkdir(parents=True)
        for name in ("__init__", "kernels", "cli"):
            (folder / package / f"{name}.py").write_text(spring)
    for module in MODULES:
        (folder / f"{module}.py").write_text(spring)
