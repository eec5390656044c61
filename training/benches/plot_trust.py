"""Draws what `posed evaluate --json` says of trust, for docs/benchmarks/trust.md: whether confidence is a probability,
whether covariances hold, and what a higher threshold costs.

    .venv/bin/python -m benches.plot_trust FIGURES.json OUT.svg [--least-visible 0.7]
"""

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("svg")

import numpy as np
from matplotlib import pyplot
from scipy.stats import chi2

BINS = 10
DEGREES = 6
INK, RIGHT, HONEST = "#1f2937", "#0e7490", "#9ca3af"


def reliability(axes, confidence, right):
    """Share of right poses by stated confidence, in bins of as many poses each."""
    order = np.argsort(confidence)
    groups = [group for group in np.array_split(order, BINS) if len(group)]
    stated = [confidence[group].mean() for group in groups]
    found = [right[group].mean() for group in groups]
    error = [1.96 * np.sqrt(max(share * (1 - share), 0.01) / len(group)) for share, group in zip(found, groups)]
    axes.plot([0, 1], [0, 1], color=HONEST, linewidth=1)
    axes.errorbar(stated, found, error, fmt="o", color=RIGHT, markersize=4, linewidth=1)
    axes.set(xlabel="stated confidence", ylabel="right", xlim=(0, 1.02), ylim=(0, 1.02), title="Confidence")


def coverage(axes, nees):
    """Share of errors within the ellipsoid of a stated probability."""
    levels = np.linspace(0, 1, 101)
    found = [(nees <= chi2.ppf(level, DEGREES)).mean() for level in levels]
    axes.plot([0, 1], [0, 1], color=HONEST, linewidth=1)
    axes.plot(levels, found, color=RIGHT)
    axes.set(
        xlabel="stated probability", ylabel="errors within", xlim=(0, 1), ylim=(0, 1), title="Covariance of ok poses"
    )


def cost(axes, confidence, right):
    """Of the poses above each threshold: how many are wrong, over how many of the right ones are kept."""
    order = np.argsort(-confidence)
    kept = np.cumsum(right[order]) / max(right.sum(), 1)
    wrong = np.cumsum(~right[order]) / np.arange(1, len(order) + 1)
    axes.plot(100 * kept, 100 * wrong, color=RIGHT)
    axes.set(xlabel="right poses kept, %", ylabel="wrong among the kept, %", xlim=(0, 100), title="Threshold")
    axes.set_ylim(bottom=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--least-visible", type=float, default=0.7)
    arguments = parser.parse_args()
    views = json.loads(arguments.figures.read_text())["views"]
    views = [view for view in views if view["nees"] and view["visible_fraction"] >= arguments.least_visible]
    confidence = np.array([view["confidence"] for view in views])
    right = np.array([view["right"] for view in views], bool)
    nees = np.array([view["nees"]["pose"]["value"] for view in views if view["status"] == "ok"])
    pyplot.rcParams.update({"font.size": 9, "axes.edgecolor": INK, "text.color": INK, "svg.hashsalt": "posed"})
    figure, (first, second, third) = pyplot.subplots(1, 3, figsize=(9.6, 3.1), layout="constrained")
    reliability(first, confidence, right)
    coverage(second, nees)
    cost(third, confidence, right)
    figure.savefig(arguments.out, metadata={"Date": None})
    print(f"{arguments.out}: {len(views)} poses, {len(nees)} of them ok")


if __name__ == "__main__":
    main()
