#!/usr/bin/python3
"""Draws how cost grows, from the files of a run: one picture with a panel for each thing that grows.

usage: plot.py RUN OUT.svg

A benchmark growth_WHAT/METHOD/NUMBER is a point of the curve METHOD in the panel WHAT, CURVE_by_WHAT/ours/NUMBER one of
the curve CURVE; the growth of robots is what
server.py measured.
"""
import argparse
import pathlib
import sys

import table

LABELS = {
    "robots": ("robots that replay at full speed", "ms of a core per robot and second"),
    "microphones": ("microphones", "ms"),
    "directions": ("candidate directions", "ms"),
    "voxels": ("voxels in the map", "ms"),
}


def curves(documents):
    """{what: {method: [(number, cost), ...]}}, numbers ascending."""
    panels = {}
    for document in documents.values():
        for point in document.get("growth_robots", []):
            panels.setdefault("robots", {}).setdefault("whole server", []).append(
                (point["robots"], sum(point["ms_per_robot_second"].values())))
    for group, methods in table.medians(documents).items():
        growth = table.GROWTH.fullmatch(group)
        if not growth:
            continue
        for method, entry in methods.items():
            curve = method if growth["curve"] is None or method != "ours" else growth["curve"]
            panels.setdefault(growth["what"], {}).setdefault(curve, []).append(
                (int(growth["number"]), table.in_ms(entry)))
    return {what: {method: sorted(points) for method, points in methods.items()} for what, methods in panels.items()}


def draw(panels, path):
    import matplotlib  # of Debian's packages, as the first line's interpreter is
    matplotlib.use("svg")
    # The same figures give the same bytes.
    matplotlib.rcParams.update({"svg.hashsalt": "soundmap", "font.size": 9})
    from matplotlib import pyplot
    order = [what for what in LABELS if what in panels] + sorted(set(panels) - set(LABELS))
    columns = min(2, len(order))
    rows = -(-len(order) // columns)
    figure, axes = pyplot.subplots(rows, columns, figsize=(5.2 * columns, 3.6 * rows), squeeze=False)
    for axis, what in zip(axes.flat, order):
        for method, points in sorted(panels[what].items()):
            axis.plot(*zip(*points), marker="o", markersize=3, label=method.replace("_", " "))
        x_label, y_label = LABELS.get(what, (what.replace("_", " "), "ms"))
        axis.set(xscale="log", yscale="linear" if what == "robots" else "log", xlabel=x_label, ylabel=y_label)
        if what == "robots":
            axis.set_ylim(bottom=0)
        axis.grid(True, which="major", alpha=0.3)
        axis.legend(fontsize=8)
    for axis in axes.flat[len(order):]:
        axis.remove()
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("run", type=pathlib.Path)
    arguments.add_argument("out", type=pathlib.Path)
    given = arguments.parse_args()
    panels = curves(table.read(given.run))
    if not panels:
        sys.exit(f"plot: {given.run} has no growth in it")
    draw(panels, given.out)


if __name__ == "__main__":
    main()
