"""A process that computes for another one, which may be killed at any moment."""

import pickle

import numpy as np
import pytest

from tuning import child
from tuning.child import Pool


def square(row):
    """The simplest work."""
    return float(np.sum(row**2))


WORK, ROW = pickle.dumps(square), pickle.dumps(np.array([3.0, 4.0]))


@pytest.mark.parametrize(
    "sent",
    [b"", WORK[:-3], WORK, WORK + ROW[:-3], WORK + ROW],
    ids=["nothing", "half a work", "a work", "half a row", "a row"],
)
def test_a_parent_that_is_killed_takes_its_workers_along_without_a_word(sent, capfd):
    """Whatever it had sent by then; nobody reads the answers any more."""
    with child.start("tuning.child") as process:
        process.stdout.close()
        process.stdin.write(sent)
        process.stdin.close()
        assert process.wait(60) == 0
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", child.ENDING)
def test_what_is_to_end_the_parent_ends_no_worker(number):
    """Not even before it runs a line of ours: a terminal sends it to all."""
    with Pool(square, 2) as pool:
        for process in pool._processes:
            process.send_signal(number)
        assert [*pool(np.array([[3.0, 4.0], [0.0, 1.0]]))] == [25.0, 1.0]


def test_a_worker_that_is_killed_is_an_error():
    """No pipe of somebody's who has seen enough: that would have been status 0."""
    with Pool(square, 2) as pool:
        pool._processes[0].kill()
        with pytest.raises(ChildProcessError, match="has ended"):
            list(pool(np.ones((8, 2))))


def test_it_answers_until_the_questions_end():
    with child.start("tuning.child") as process:
        for question in (square, np.array([3.0, 4.0])):
            child.send(process, question)
        assert child.receive(process) == 25.0
        process.stdin.close()
        assert process.wait(60) == 0
