"""Where the system gives no shared memory, everything goes on without it."""

import json

import pytest

from tests.fuzzbee.processes import default_session, shell
from tests.fuzzbee.recording import TAKEOFF
from tests.programs import can_mount

READ_ONLY, TINY = "-o ro", "-o size=4k"


def run_in(mount, *arguments):
    """A command in a namespace of its own, in which /dev/shm is another one."""
    script = f'mount -t tmpfs {mount} none /dev/shm && exec "$@"'
    return shell(f"unshare -rm sh -c '{script}' sh \"$@\"", *arguments)


pytestmark = pytest.mark.skipif(
    not can_mount("mount -t tmpfs none /dev/shm"), reason="no namespaces of one's own here"
)


@pytest.mark.parametrize("mount", [READ_ONLY, TINY])
def test_a_run_goes_on_with_a_line(mount):
    done = run_in(mount, "run", "sim:", "--seconds", "2", "--json", *default_session())
    assert json.loads(done.stdout)["vehicles"]["1"]["attitudes"] > 0
    assert done.stderr.count("no shared memory, going on without") == 1


def test_logs_are_checked_one_after_the_other():
    done = run_in(READ_ONLY, "check", str(TAKEOFF), str(TAKEOFF))
    assert done.stdout.count("no difference") == 2
