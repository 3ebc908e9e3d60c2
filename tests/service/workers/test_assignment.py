from service.workers.assignment import Assignment


def test_systems_that_appear_at_once_are_shared_out_evenly():
    assignment = Assignment(3)
    for _ in range(2):
        for system in range(1, 91):
            assignment.worker(system)
    assert [len(assignment.systems(worker)) for worker in range(3)] == [30, 30, 30]


def test_a_system_stays_where_it_is_whatever_else_comes():
    assignment = Assignment(4)
    first = {system: assignment.worker(system) for system in range(1, 20)}
    for second in range(5):
        assignment.close_window()
        for system in range(1, 60 + second):
            assignment.worker(system)
    assert {system: assignment.worker(system) for system in first} == first
    assert assignment.known(1) == first[1]
    assert assignment.known(200) is None


def test_a_new_one_goes_where_fewest_frames_come_not_fewest_systems():
    assignment = Assignment(2)
    for _ in range(100):
        assignment.worker(1)  # fast, on its own
    for system in (2, 3, 4):
        for _ in range(5):
            assignment.worker(system)
    assert assignment.systems(0) == [1, 3]
    assignment.close_window()
    newcomers = [assignment.worker(system) for system in (5, 6)]
    assert newcomers == [1, 1]


def test_those_that_have_gone_silent_do_not_count():
    assignment = Assignment(2)
    for system in range(1, 11):
        assignment.worker(system)
    silent, living = assignment.systems(0), assignment.systems(1)
    assignment.close_window()
    for system in living:
        for _ in range(50):
            assignment.worker(system)
    assignment.close_window()
    assert [assignment.worker(100 + number) for number in range(3)] == [0, 0, 0]
    assert assignment.systems(0)[: len(silent)] == silent
