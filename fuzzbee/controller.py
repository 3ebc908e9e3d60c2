"""The paper's fuzzy controller as scikit-fuzzy's own objects, and a figure of it."""

from pathlib import Path

import numpy as np
from skfuzzy import control, trimf

from estimator.filter.fuzzy import RULES, fuzzy_gain
from estimator.filter.memberships import TERMS, Five, Memberships, fuzzy_sets
from estimator.types import Floats
from fuzzbee.replays.figure import draw_sets, require_plot, written_figure

FULL = 100.0  # of k_op
POINTS = 1001  # of a universe, beside the corners of the sets
STEPS = 201  # of the drawn surface, each way
FIGURE_INCHES = (11.0, 8.0)


def control_system(k: Memberships, points: int = POINTS) -> control.ControlSystem:
    """Memberships (Figs. 4 and 5) and the 25 rules (Table I) as a control system.

    Its inputs are ``error`` and ``error_rate`` on [0, 1], its output ``k_op`` on [0, 100]; K is
    1 + k_op. scikit-fuzzy integrates over ``points`` samples and the corners of the sets, the
    filter exactly: the more points, the closer the two are (1e-9 at 100 000).
    """
    sets = fuzzy_sets(k)
    error = control.Antecedent(_universe(sets.inputs, 1.0, points), "error")
    rate = control.Antecedent(_universe(sets.inputs, 1.0, points), "error_rate")
    gain = control.Consequent(_universe(sets.output, FULL, points), "k_op")
    for variable, five in ((error, sets.inputs), (rate, sets.inputs), (gain, sets.output)):
        for term, corners in zip(TERMS, five, strict=True):
            variable[term] = trimf(variable.universe, np.array(corners))
    rules = [
        control.Rule(rate[TERMS[row]] & error[TERMS[column]], gain[TERMS[consequent]])
        for row, consequents in enumerate(RULES)
        for column, consequent in enumerate(consequents)
    ]
    return control.ControlSystem(rules)


def _universe(sets: Five, end: float, points: int) -> Floats:
    """An even grid with every corner, and both sides of it, where an edge may be vertical."""
    corners = np.array([corner for corners in sets for corner in corners])
    sides = (np.nextafter(corners, -1.0), corners, np.nextafter(corners, 2.0 * end))
    grid = np.concatenate([np.linspace(0.0, end, points), *sides])
    return np.unique(np.clip(grid, 0.0, end))


def draw_controller(path: Path, name: str, k: Memberships) -> None:
    """Draw memberships, rules and the surface of K into a file."""
    require_plot(path)
    sets = fuzzy_sets(k)
    with written_figure(path, f"Fuzzy controller of profile {name}", FIGURE_INCHES) as sheet:
        (inputs, output), (rules, gains) = sheet.subplots(2, 2)
        draw_sets(inputs, "error e, and its rate in 1/s", sets.inputs)
        draw_sets(output, "k_op", sets.output)
        inputs.set_xlim(0.0, 1.0)
        output.set_xlim(0.0, FULL)
        rules.axis("off")
        rules.set_title("k_op by rate (rows) and error (columns)")
        cells = [[TERMS[consequent] for consequent in row] for row in RULES]
        words = {"cellLoc": "center", "rowLoc": "center", "rowLabels": TERMS, "colLabels": TERMS}
        rules.table(cells, bbox=(0.1, 0.0, 0.9, 1.0), **words)
        gains.grid(visible=False)
        # by the compiled inference: scikit-fuzzy takes 20 ms for each point
        grid = np.linspace(0.0, 1.0, STEPS).tolist()
        K = [[1.0 + fuzzy_gain(k, error, rate) for error in grid] for rate in grid]
        sheet.colorbar(gains.pcolormesh(grid, grid, K, rasterized=True), ax=gains)
        gains.set(xlim=(0.0, 1.0), xlabel="error e", ylim=(0.0, 1.0), ylabel="rate of e in 1/s")
        gains.set_title("K = 1 + k_op")
