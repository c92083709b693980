#!/usr/bin/env python3
"""Puts our figures beside those of the peer methods of the same run.

usage: table.py RUN                 print the table of a run
       table.py RUN --keep KEPT     and keep the run: its files, and the table in KEPT/README.md

RUN and KEPT are folders of Google Benchmark's JSON files, a program each, and the one that server.py writes. A benchmark's name is
GROUP/METHOD; the method `ours` is compared with every other one of its group. All figures are
medians over the repetitions, times are CPU times.
"""
import argparse
import json
import pathlib
import re
import sys

ALLOWED_LOSS = 0.25  # of a ratio: what a noisy neighbour may cost
ALLOWED_ELSEWHERE = 0.5  # on a processor with other caches: what fits into them differs from method to method
# Groups that are plotted, see plot.py: growth_WHAT, or CURVE_by_WHAT.
GROWTH = re.compile(r"(?:growth|(?P<curve>\w+)_by)_(?P<what>\w+)/(?P<number>\d+)")
NOT_COUNTERS = {
    "name", "family_index", "per_family_instance_index", "run_name", "run_type", "repetitions",
    "threads", "aggregate_name", "aggregate_unit", "iterations", "real_time", "cpu_time",
    "time_unit", "repetition_index", "label",
}


def read(folder):
    """{file name: document} of the programs that ran anything."""
    documents = {}
    for path in sorted(folder.glob("*.json")):
        text = path.read_text()
        if text.strip():
            documents[path.name] = json.loads(text)
    return {name: document for name, document in documents.items()
            if document.get("benchmarks") or "full_speed" in document}


def group_and_method(name):
    """Google Benchmark appends the arguments: a/ours/200/60 is the method `ours` of a/200/60."""
    parts = name.split("/")
    last = len(parts)
    while last > 1 and parts[last - 1].rpartition(":")[2].isdigit():
        last -= 1
    return "/".join(parts[:last - 1] + parts[last:]), parts[last - 1]


def medians(documents):
    """{group: {method: entry}}, in the order of the programs and of their benchmarks."""
    groups = {}
    for document in documents.values():
        # Interleaved repetitions end in any order.
        for entry in sorted(document.get("benchmarks", []), key=lambda entry: entry["family_index"]):
            if "error_occurred" in entry:
                sys.exit(f"{entry['name']}: {entry.get('error_message')}")
            if entry.get("aggregate_name") == "median":
                group, method = group_and_method(entry["run_name"])
                groups.setdefault(group, {})[method] = entry
    return groups


def in_ms(entry):
    return entry["cpu_time"] * {"ns": 1e-6, "us": 1e-3, "ms": 1.0, "s": 1e3}[entry["time_unit"]]


def ratios(groups):
    """{(group, peer): how many times as long the peer takes}"""
    return {
        (group, method): in_ms(entry) / in_ms(methods["ours"])
        for group, methods in groups.items() if "ours" in methods
        for method, entry in methods.items() if method != "ours"
    }


def figures(entry):
    parts = [f"{in_ms(entry):.3g} ms"]
    for name, value in entry.items():
        if name in NOT_COUNTERS or not isinstance(value, (int, float)):
            continue
        if name == "items_per_second":
            parts.append(f"{value / 1e6:.3g} M/s")
        else:
            parts.append(f"{name.replace('_', ' ')} {value:.3g}")
    return ", ".join(parts)


def markdown(groups):
    ratio_of = ratios(groups)
    rows = [("what", "method", "median", "ours is faster by"), ("---",) * 4]
    for group, methods in groups.items():
        if GROWTH.fullmatch(group):
            continue
        order = sorted(methods, key=lambda method: (method != "ours", in_ms(methods[method])))
        for method in order:
            ratio = ratio_of.get((group, method))
            rows.append((group if method == order[0] else "", method, figures(methods[method]),
                         f"{ratio:.2f}" if ratio else ""))
    return aligned(rows)


def server_rows(server):
    """What server.py measured, as lines of a table and one of stages."""
    full = server["full_speed"]
    rows = [("what", "figure"), ("---", "---"),
            (f"robots per core, {full['robots']} replay {full['seconds']} s at full speed",
             f"{full['robots_per_core']:.1f} ({min(full['robots_per_core_of_runs']):.1f} to "
             f"{max(full['robots_per_core_of_runs']):.1f})"),
            ("bytes a robot sends", f"{full['wire_bytes_per_s'] / 1e3:.0f} kB/s"),
            ("memory, nothing stored", f"{server['empty_memory_mb']:.0f} MB")]
    if "streaming" in server:
        live = server["streaming"]
        rows += [("memory, one site with its building", f"{live['memory_before_mb']:.0f} MB"),
                 (f"memory per robot, {live['robots']} stream", f"{live['memory_per_robot_mb']:.1f} MB"),
                 (f"load of the core, {live['robots']} stream", f"{100 * live['core_share']:.0f} %")]
        for name, what in (("box_query", "box query, 2 m"), ("source_list", "source list")):
            query = live["queries"][name]
            rows.append((f"{what}, {live['robots']} stream",
                         f"p50 {query['p50_ms']:.2f} ms, p99 {query['p99_ms']:.2f} ms"))
    if "two_cores" in server:
        two = server["two_cores"]
        rows.append(("robots on two cores by the clock; speed-up over one",
                     f"{two['robots_by_wall']:.1f}; {two['speed_up']:.2f}"))
        rows.append(("robots on two cores if the server had both to itself, at its cost there",
                     f"{2.0 * two['robots_per_core']:.1f}"))
    stages = sorted(full["ms_per_robot_second"].items(), key=lambda stage: -stage[1])
    total = sum(ms for _, ms in stages)
    # Amdahl: the writer of a site's map is one at a time; of the commit, encoding is not, so that this is a bound.
    serial = sum(ms for stage, ms in stages if stage in ("commit", "map")) / total
    model = [full["robots_per_core"] / (serial + (1.0 - serial) / cores) for cores in (2, 8, 64)]
    rows.append((f"robots on 2, 8, 64 cores by Amdahl, all at one site, of whose work {100 * serial:.0f} % is one at a time",
                 ", ".join(f"{robots:.0f}" for robots in model)))
    split = [("stage", "ms of a core per robot and second", "share"), ("---",) * 3]
    split += [(name, f"{ms:.2f}", f"{100 * ms / total:.1f} %") for name, ms in stages]
    split.append(("all", f"{total:.2f}", ""))
    return rows, split


def aligned(rows):
    width = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        fill = "-" if row[0] == "---" else " "
        lines.append("| " + " | ".join(cell.ljust(w, fill) for cell, w in zip(row, width)) + " |")
    return "\n".join(lines)


def page_of(documents):
    """The tables of a run."""
    parts = []
    if groups := medians(documents):
        parts.append(markdown(groups))
    for document in documents.values():
        if "full_speed" in document:
            parts += [aligned(rows) for rows in server_rows(document)]
    return "\n\n".join(parts)


def machine(documents):
    contexts = [document["context"] for document in documents.values()]
    context = next((context for context in contexts if "mhz_per_cpu" in context), contexts[0])
    speed = f" at {context['mhz_per_cpu']} MHz" if "mhz_per_cpu" in context else ""
    return (f"{context.get('cpu', 'unknown processor')}, {context['num_cpus']} cores{speed}, "
            f"{context.get('compiler', 'unknown compiler')}, {context['date'][:10]}")


def keep(documents, kept):
    for name, document in documents.items():
        for private in ("executable", "host_name"):
            document["context"].pop(private, None)
        (kept / name).write_text(json.dumps(document, indent=1) + "\n")
    page = kept / "README.md"
    before, begin, rest = page.read_text().partition("<!-- begin table -->\n")
    _, end, after = rest.partition("<!-- end table -->\n")
    if not begin or not end:
        sys.exit(f"{page} has no place for the table")
    everything = read(kept)
    table = f"{page_of(everything)}\n\nMachine: {machine(documents)}.\n"
    page.write_text(before + begin + "\n" + table + "\n" + end + after)


def main():
    arguments = argparse.ArgumentParser(description=__doc__,
                                        formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("run", type=pathlib.Path)
    arguments.add_argument("--keep", type=pathlib.Path, metavar="KEPT")
    given = arguments.parse_args()
    documents = read(given.run)
    if not documents:
        sys.exit("no benchmark ran")
    print(page_of(documents))
    if given.keep:
        keep(documents, given.keep)


if __name__ == "__main__":
    main()
