"""How many vehicles does the live service carry, how late, and at what cost?

    python benchmarks/live.py --vehicles 200 --rate 50 --seconds 20 [--plain]

The vehicles send over UDP on loopback, ``fuzzbee run`` estimates and publishes on Zenoh, a third
process subscribes. ``--plain``: a script of pymavlink and ahrs (processes/plain.py) has the
service's place. ``--record FOLDER``: it records there all that comes. Times are median, 99th
percentile and worst in ms, of an attitude:

- ``sample to subscriber``: from the sending of its latest sample's datagram to the subscriber's
  callback; ``new sample to subscriber`` of the first attitude after each sample only.
- ``tick late``: the tick against its schedule, the grid of periods under all ticks; a tick that is
  a whole period late shows in ``ticks apart``.

``shed`` samples are those that an overloaded service left out and counted, ``lost`` those that the
system threw away, as the service has counted, ``uncounted`` the others that were not taken.
Cores and memory are those of all processes of the service. With ``--capacity`` the number of
vehicles is searched that is carried with less than 0.1 % not taken.
"""

import sys
import time
from argparse import Namespace

from common.filters import is_installed
from common.report import MISSING, Row, parser, show
from processes.trial import (
    WARM_UP_S,
    BeginService,
    Process,
    Shape,
    counts,
    cpu_s,
    family,
    figures,
    fuzzbee,
    memory_mb,
    plain,
    run,
)

# A number of vehicles is carried if less than this share of the samples is lost or left out.
CARRIED = 0.001
FIRST_VEHICLES, MOST_VEHICLES, FINENESS = 64, 500, 0.1


def measure(shape: Shape, begin_service: BeginService) -> Row:
    """One run of the processes."""
    marks: list[tuple[int, list[float]]] = []
    memory: list[float] = []

    def meanwhile(service: Process, others: list[int]) -> None:
        time.sleep(WARM_UP_S)
        processes = [*family(service.pid), *others]
        for wait_s in (0.0, shape.seconds - WARM_UP_S - 0.2):
            time.sleep(wait_s)
            marks.append((time.time_ns(), [cpu_s(pid) for pid in processes]))
        memory.extend(memory_mb(pid) for pid in processes[: -len(others)])

    seen = run(shape, begin_service, meanwhile)
    (begin_ns, before), (end_ns, after) = marks
    window_s = (end_ns - begin_ns) / 1e9
    cores = [round((b - a) / window_s, 3) for a, b in zip(before, after, strict=True)]
    return {
        "vehicles": shape.vehicles,
        "Hz": shape.rate_hz,
        **figures(seen, (begin_ns, end_ns), shape.publish_hz),
        **counts(seen),
        "cores of the service": cores[: len(memory)],
        "of subscriber, fleet": cores[len(memory) :],
        "MB": round(sum(memory), 1),
    }


def capacity(options: Namespace, begin_service: BeginService) -> Row:
    """The run with the most vehicles that is carried, found by bisection."""
    carried, too_many, best = 0, MOST_VEHICLES + 1, None
    vehicles = FIRST_VEHICLES
    while too_many - carried > max(1, carried * FINENESS):
        result = measure(shape_of(options, vehicles), begin_service)
        lost = 1.0 - result["taken"] / max(1, result["sent"])
        print(f"{vehicles} vehicles: {lost:.2%} not taken", file=sys.stderr)
        if lost < CARRIED:
            carried, best = vehicles, result
        else:
            too_many = vehicles
        beyond = too_many > MOST_VEHICLES
        vehicles = min(2 * vehicles, MOST_VEHICLES) if beyond else (carried + too_many) // 2
    if best is None:
        raise SystemExit("not even one vehicle is carried")
    return best


def shape_of(options: Namespace, vehicles: int) -> Shape:
    publish_hz = options.rate if options.publish_rate is None else options.publish_rate
    return Shape(vehicles, options.rate, options.seconds, publish_hz)


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--vehicles", type=int, default=1)
    made.add_argument("--rate", type=float, default=50.0, help="samples a second and vehicle")
    made.add_argument("--seconds", type=float, default=10.0)
    made.add_argument("--publish-rate", type=float, help="attitudes a second [as --rate]")
    made.add_argument("--record", default="", help="folder that the service records to")
    made.add_argument("--plain", action="store_true", help="pymavlink and ahrs instead")
    made.add_argument("--capacity", action="store_true", help="search the most vehicles")
    options = made.parse_args()
    if options.smoke:
        options.vehicles, options.seconds, options.capacity = 2, WARM_UP_S + 2.0, False
    if options.seconds <= WARM_UP_S:
        made.error(f"--seconds: more than {WARM_UP_S:g}")

    def recording(port: int, endpoint: str, publish_hz: float) -> Process:
        return fuzzbee(port, endpoint, publish_hz, "--record", options.record)

    rivals: dict[str, BeginService | None] = {
        "fuzzbee": recording if options.record else fuzzbee,
        "plain script": plain if is_installed("mahony") else None,
    }
    chosen = ["plain script"] if options.plain else ["fuzzbee"]
    rows: list[Row] = []
    for name in list(rivals) if options.smoke else chosen:
        begin_service = rivals[name]
        if begin_service is None:
            rows.append({"service": name, "vehicles": f"ahrs: {MISSING}"})
            continue
        if options.capacity:
            found = capacity(options, begin_service)
        else:
            found = measure(shape_of(options, options.vehicles), begin_service)
        rows.append({"service": name, **found})
    show({"live": rows}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
