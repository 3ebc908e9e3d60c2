"""How much faster the compiled filter step is than scikit-fuzzy's control system.

Both get the same inputs, pairs of error and rate of change of error drawn
uniformly from [0, 1] (again where no rule fires: there the control system has
no output), in one run on one core:

* ``skfuzzy_control_ns``: one ``compute()`` of one
  ``skfuzzy.control.ControlSystemSimulation``, built once before the clock
  starts, with 101-point universes and its cache of earlier results off. It
  includes setting both inputs and reading the output. Fuzzy inference alone.
* ``step_ns``: one whole compiled filter step, called from compiled code:
  vectors from the sample, propagation, correction, and the fuzzy inference
  with its exact centroid. The filter works out error and rate from its state
  and a sample; here each step starts from a state and a sample that make them
  the given pair, so that the inference sees the same inputs. Preparing states
  and samples is not timed; reading and writing them is. Compilation is not
  timed.

Each is the best of several repetitions, the one that other programs disturbed least.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator.compilation.compiled import compiled
from estimator.filter import kernel
from estimator.filter.fuzzy import RULES, fuzzy_gain
from estimator.filter.memberships import TERMS, fuzzy_sets, midpoint
from estimator.filter.noise_gain import NO_NOISE
from estimator.filter.types import NO_DECAY, FilterState
from estimator.geometry.quaternion import exp, rotate_inverse, unit
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from estimator.types import NOTHING_BETWEEN, Sample

INPUTS = 2_000
CONTROL_CALLS = 200
REPETITIONS = 5
STEP_S = 0.01
GRID_POINTS = 101
# The two must compute the same thing for a ratio to mean something. The control system samples both
# universes at 101 points: it is off by some hundredths as a rule, and by points at vertical edges.
LARGEST_MEDIAN_DIFFERENCE = 0.3


def control_simulation(k):
    """The controller in scikit-fuzzy's control API, with the 25 rules."""
    from skfuzzy import control, trimf

    sets = fuzzy_sets(k)
    error = control.Antecedent(np.linspace(0.0, 1.0, GRID_POINTS), "error")
    rate = control.Antecedent(np.linspace(0.0, 1.0, GRID_POINTS), "rate")
    gain = control.Consequent(np.linspace(0.0, 100.0, GRID_POINTS), "gain")
    for variable, triangles in ((error, sets.inputs), (rate, sets.inputs), (gain, sets.output)):
        for term, corners in zip(TERMS, triangles, strict=True):
            variable[term] = trimf(variable.universe, np.array(corners))
    rules = [
        control.Rule(rate[TERMS[row]] & error[TERMS[column]], gain[TERMS[consequent]])
        for row, consequents in enumerate(RULES)
        for column, consequent in enumerate(consequents)
    ]
    return control.ControlSystemSimulation(control.ControlSystem(rules), cache=False)


def compute(simulation, error, rate):
    simulation.input["error"] = error
    simulation.input["rate"] = rate
    simulation.compute()
    return simulation.output["gain"]


@compiled
def step_all(params, reference, states, gyr, acc, mag, gains):
    """One step from each state (N, 6: q, error, rate) with its own sample (N, 3)."""
    for i in range(len(states)):
        s = states[i]
        q, zero = (s[0], s[1], s[2], s[3]), (0.0, 0.0, 0.0)
        state = FilterState(q, zero, s[4], s[5], 1.0, True, zero, NO_NOISE, NO_DECAY)
        sample = Sample(
            gyr_rad_s=(gyr[i, 0], gyr[i, 1], gyr[i, 2]),
            acc_m_s2=(acc[i, 0], acc[i, 1], acc[i, 2]),
            mag=(mag[i, 0], mag[i, 1], mag[i, 2]),
            has_mag=True,
            dt_s=STEP_S,
            between=NOTHING_BETWEEN,
        )
        after = kernel.step(params, reference, state, sample)
        gains[i, 0] = after.error
        gains[i, 1] = after.error_rate_1_s
        gains[i, 2] = after.gain


def states_and_samples(settings, pairs, rng):
    """States and noise-free samples from which the step finds these errors and rates."""
    tau = settings.filter.rate_time_constant_s
    share = STEP_S / (tau + STEP_S)
    states = np.zeros((len(pairs), 6))
    acc, mag = np.empty((len(pairs), 3)), np.empty((len(pairs), 3))
    for i, (error, rate) in enumerate(pairs):
        angle = 2.0 * np.arcsin(np.sqrt(error))
        axis = unit(tuple(rng.standard_normal(3)))
        truth = exp(tuple(angle * x for x in axis))  # the estimate is the identity
        acc[i] = [-9.8 * x for x in rotate_inverse(truth, settings.reference.gravity_ned)]
        mag[i] = [0.5 * x for x in rotate_inverse(truth, settings.reference.magnetic_ned)]
        # d = d0 + share ((e - e0)/dt - d0) with e0 = e
        states[i] = (1.0, 0.0, 0.0, 0.0, error, rate / (1.0 - share))
    return states, np.zeros((len(pairs), 3)), acc, mag


def best_ns(function, calls):
    elapsed = []
    for _ in range(REPETITIONS):
        start = time.perf_counter_ns()
        function()
        elapsed.append((time.perf_counter_ns() - start) / calls)
    return min(elapsed)


def measure(seed=0):
    rng = np.random.default_rng(seed)
    settings = settings_of(load_profile("paper"))
    k = midpoint()
    params = settings.filter._replace(memberships=k)
    pairs = rng.uniform(0.0, 1.0, (2 * INPUTS, 2))
    pairs = np.array([p for p in pairs if fuzzy_gain(k, p[0], p[1]) > 0.0])[:INPUTS]
    states, gyr, acc, mag = states_and_samples(settings, pairs, rng)
    results = np.empty((INPUTS, 3))

    def steps():
        step_all(params, settings.reference, states, gyr, acc, mag, results)

    steps()  # compiles
    if not np.allclose(results[:, :2], pairs, atol=1e-9):
        raise SystemExit("the steps did not see the errors and rates that the control system gets")

    simulation = control_simulation(k)
    few = [(float(error), float(rate)) for error, rate in pairs[:CONTROL_CALLS]]
    outputs = np.array([compute(simulation, error, rate) for error, rate in few])
    difference = float(np.median(np.abs(1.0 + outputs - results[:CONTROL_CALLS, 2])))
    if difference > LARGEST_MEDIAN_DIFFERENCE:
        raise SystemExit(f"the two controllers disagree by {difference:.2f} (median)")

    step_ns = best_ns(steps, INPUTS)
    control_ns = best_ns(lambda: [compute(simulation, *pair) for pair in few], len(few))
    return {
        "step_ns": round(step_ns, 1),
        "skfuzzy_control_ns": round(control_ns),
        "skfuzzy_ratio": round(control_ns / step_ns),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    as_json = parser.parse_args().json
    result = measure()
    if as_json:
        print(json.dumps(result))
    else:
        print(f"compiled step with inference  {result['step_ns']:12.1f} ns")
        print(f"scikit-fuzzy control system   {result['skfuzzy_control_ns']:12d} ns")
        print(f"ratio                         {result['skfuzzy_ratio']:12d}")


if __name__ == "__main__":
    main()
