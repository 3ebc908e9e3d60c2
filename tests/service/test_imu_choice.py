from service.imu_choice import ImuChoice, consider

LATE_US = 500_000


def feed(choice, *messages, start_us=0, step_us=10_000):
    for number, message in enumerate(messages):
        choice = consider(choice, message, start_us + number * step_us, LATE_US)
    return choice


def test_the_first_message_is_taken():
    assert feed(ImuChoice(), "SCALED_IMU2").message == "SCALED_IMU2"


def test_other_messages_of_a_batch_do_not_interfere():
    batch = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
    assert feed(ImuChoice(), *(batch * 20)).message == "RAW_IMU"


def test_a_preferred_message_takes_over_once_it_is_steady():
    choice = feed(ImuChoice(), "SCALED_IMU2", "RAW_IMU", "SCALED_IMU2", "RAW_IMU")
    assert choice.message == "SCALED_IMU2"
    assert feed(choice, "RAW_IMU", start_us=40_000).message == "RAW_IMU"


def test_a_preferred_message_now_and_then_does_not():
    choice = feed(ImuChoice(), "HIGHRES_IMU")
    for second in range(20):
        choice = feed(choice, "RAW_IMU", *["HIGHRES_IMU"] * 50, start_us=second * 1_000_000)
        assert choice.message == "HIGHRES_IMU"


def test_change_over_when_the_chosen_one_goes_silent():
    choice = feed(ImuChoice(), "RAW_IMU")
    assert feed(choice, "SCALED_IMU2", start_us=LATE_US).message == "RAW_IMU"
    assert feed(choice, "SCALED_IMU2", start_us=LATE_US + 1).message == "SCALED_IMU2"


def test_names_of_log_formats_are_usable():
    assert feed(ImuChoice(), "sensor_combined", "IMU").message == "sensor_combined"


def test_a_slow_but_steady_preferred_message_proves_itself_by_its_last_arrival():
    """RAW_IMU at 2.5 Hz beside a fast second IMU: each is in time for the one before it."""
    choice = feed(ImuChoice(), "SCALED_IMU2")
    for k in range(1, 3):
        choice = feed(choice, "SCALED_IMU2", "RAW_IMU", start_us=400_000 * k)
        assert choice.message == "SCALED_IMU2"
    choice = feed(choice, "SCALED_IMU2", "RAW_IMU", start_us=1_200_000)
    assert choice.message == "RAW_IMU"


def test_one_that_pauses_begins_anew():
    choice = feed(ImuChoice(), "SCALED_IMU2", "RAW_IMU", "RAW_IMU", "SCALED_IMU2")
    for k in range(5):
        choice = feed(choice, "SCALED_IMU2", start_us=300_000 * (k + 1))
    assert feed(choice, "RAW_IMU", start_us=1_510_000).message == "SCALED_IMU2"
