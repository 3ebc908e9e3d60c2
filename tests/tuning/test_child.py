"""A process that computes for another one, which may be killed at any moment."""

import pickle

import numpy as np
import pytest

from tuning import child
from tuning.workers import Workers


class Squares:
    """The simplest objective."""

    def costs(self, values):
        return np.sum(values**2, axis=1)


OBJECTIVE, ROW = pickle.dumps(Squares()), pickle.dumps(np.array([3.0, 4.0]))


@pytest.mark.parametrize(
    "sent",
    [b"", OBJECTIVE[:-3], OBJECTIVE, OBJECTIVE + ROW[:-3], OBJECTIVE + ROW],
    ids=["nothing", "half an objective", "an objective", "half a row", "a row"],
)
def test_a_parent_that_is_killed_takes_its_workers_along_without_a_word(sent, capfd):
    """Whatever it had sent by then; nobody reads the answers any more."""
    with child.start("tuning.workers") as process:
        process.stdout.close()
        process.stdin.write(sent)
        process.stdin.close()
        assert process.wait(60) == 0
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", child.ENDING)
def test_what_is_to_end_the_parent_ends_no_worker(number):
    """Not even before it runs a line of ours: a terminal sends it to all."""
    with Workers(Squares(), 2) as workers:
        for process in workers._processes:
            process.send_signal(number)
        assert workers(np.array([[3.0, 4.0], [0.0, 1.0]])).tolist() == [25.0, 1.0]


def test_a_worker_that_is_killed_is_an_error():
    """No pipe of somebody's who has seen enough: that would have been status 0."""
    with Workers(Squares(), 2) as workers:
        workers._processes[0].kill()
        with pytest.raises(ChildProcessError, match="has ended"):
            workers(np.ones((8, 2)))


def test_it_answers_until_the_questions_end():
    with child.start("tuning.workers") as process:
        for question in (Squares(), np.array([3.0, 4.0])):
            child.send(process, question)
        assert child.receive(process) == 25.0
        process.stdin.close()
        assert process.wait(60) == 0
