import gc
import sys

from service.steady import SWITCH_INTERVAL_S, steady


def test_the_process_is_as_before_afterwards():
    interval_s, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    with steady():
        assert abs(sys.getswitchinterval() - SWITCH_INTERVAL_S) < 1e-6
        assert gc.get_freeze_count() > 1000
    assert sys.getswitchinterval() == interval_s
    assert gc.get_freeze_count() == frozen
