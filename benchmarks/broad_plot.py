"""The benchmark's picture: total error by trial, one mark a filter."""

from pathlib import Path
from typing import Any


def plot(result: dict[str, Any], file: Path) -> None:
    """Draw ``result`` of the benchmark into ``file``; needs matplotlib."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    filters = result["filters"]
    names = list(next(iter(filters.values()))["per_trial"])
    figure, axes = plt.subplots(figsize=(9, 0.28 * len(names) + 1.6), layout="constrained")
    rows = range(len(names))
    for filter_name, entry in filters.items():
        label = f"{filter_name} {entry['total_rms_deg']:.2f}"
        ours = filter_name == "fuzzbee"
        axes.plot(
            [entry["per_trial"][name] for name in names],
            rows,
            "o" if ours else "|",
            label=label,
            markersize=6 if ours else 10,
            markeredgewidth=1 if ours else 2,
        )
    axes.set_yticks(rows, [name.replace("_", " ") for name in names], fontsize=7)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("total RMS error, degrees (legend: mean over trials)")
    axes.grid(visible=True, axis="x", which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(file, dpi=130)
    plt.close(figure)
