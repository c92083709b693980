#!/usr/bin/env python3
"""Fails when we lead a peer method by much less than in the run that is kept.

usage: check.py BIN KEPT

Of every group of the kept run, our method and its fastest peer run again, side by side: only what both take in
the same run is compared, so that a slow machine slows both. Of each method the fastest of the interleaved repetitions
counts: a busy neighbour only ever adds, and to what lives in the cache more than to what does not. A group that seems
to have lost runs again, longer, before it counts: noise passes, a loss stays. On a processor with other caches than
the kept run's, a ratio may be half of what it was there.
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import table

# How often and how long (in seconds) each method runs in one go; the later goes are only for what failed before.
GOES = ((9, 0.03), (15, 0.05), (25, 0.1))


# Groups whose peer is our own code for another processor: how far they lie apart is the processor's doing.
OF_THE_PROCESSOR = "inner_loop"


class CannotRun(Exception):
    pass


def caches_of(document):
    """Which tell one processor from another."""
    return [cache["size"] for cache in document.get("context", {}).get("caches", [])]


def rows_of(document):
    """{group: (our benchmark, the fastest peer's benchmark, the peer's method, ratio)} of a program's kept run."""
    groups = table.medians({"": document})
    rows = {}
    for group, methods in groups.items():
        peers = {method: entry for method, entry in methods.items() if method != "ours"}
        if "ours" not in methods or not peers or table.GROWTH.fullmatch(group) or group.startswith(OF_THE_PROCESSOR):
            continue
        fastest = min(peers, key=lambda method: table.in_ms(peers[method]))
        rows[group] = (methods["ours"]["run_name"], peers[fastest]["run_name"], fastest,
                       table.in_ms(peers[fastest]) / table.in_ms(methods["ours"]))
    return rows


def measure(program, names, repetitions, seconds):
    """{group: {method: ms}} of these benchmarks of a program, and the caches of this processor."""
    pattern = "^(" + "|".join(re.escape(name) for name in sorted(names)) + ")$"
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "out.json"
        result = subprocess.run(
            [program, f"--benchmark_filter={pattern}", f"--benchmark_repetitions={repetitions}",
             f"--benchmark_min_time={seconds}", "--benchmark_enable_random_interleaving=true",
             f"--benchmark_out={out}", "--benchmark_out_format=json"],
            capture_output=True, text=True)
        if result.returncode != 0:
            raise CannotRun(f"{program.name} failed: {result.stderr.strip()[-1000:]}")
        fastest = {}
        document = json.loads(out.read_text() or "{}")
        for entry in document.get("benchmarks", []):
            if "error_occurred" in entry:
                raise CannotRun(f"{entry['name']}: {entry.get('error_message')}")
            if entry.get("run_type") == "iteration":
                group, method = table.group_and_method(entry["run_name"])
                methods = fastest.setdefault(group, {})
                methods[method] = min(methods.get(method, float("inf")), table.in_ms(entry))
        return fastest, caches_of(document)


def check(programs, kept, goes=GOES, say=print):
    """The groups that lost, each with its last ratio, the kept one and the share of it that it may lose. `programs`: {name: path}, `kept`: a folder."""
    rows = {}
    for file_name, document in table.read(kept).items():
        program = programs.get(pathlib.Path(file_name).stem)
        for group, row in rows_of(document).items():
            if program is None:
                say(f"{group}: no program measures it")
            else:
                rows[group] = (program, *row, caches_of(document))
    if not rows:
        raise CannotRun("nothing of the run kept can be measured")
    lost = {}
    for go, (repetitions, seconds) in enumerate(goes):
        pending = lost if go > 0 else rows
        lost = {}
        for program in sorted({rows[group][0] for group in pending}):
            mine = {group for group in pending if rows[group][0] == program}
            names = {name for group in mine for name in rows[group][1:3]}
            measured, caches = measure(program, names, repetitions, seconds)
            for group in sorted(mine):
                _, _, _, peer, before, caches_before = rows[group]
                methods = measured.get(group, {})
                if "ours" not in methods or peer not in methods:
                    say(f"{group}: no longer measured against {peer}")
                    continue
                now = methods[peer] / methods["ours"]
                allowed = table.ALLOWED_LOSS if caches == caches_before else table.ALLOWED_ELSEWHERE
                falls = now < (1.0 - allowed) * before
                say(f"{group}: ours is {now:.2f} times as fast as {peer}; kept: {before:.2f}"
                    f"{' - less than allowed' if falls else ''}")
                if falls:
                    lost[group] = (peer, now, before, allowed)
        if not lost:
            break
    return lost


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("bin", type=pathlib.Path)
    arguments.add_argument("kept", type=pathlib.Path)
    given = arguments.parse_args()
    programs = {path.name.removesuffix("_benchmark"): path.resolve() for path in given.bin.glob("*_benchmark")}
    try:
        lost = check(programs, given.kept)
    except CannotRun as error:
        sys.exit(f"check: {error}")
    for group, (peer, now, before, allowed) in lost.items():
        print(f"check: {group}: ours is {now:.2f} times as fast as {peer}, which is more than "
              f"{100 * allowed:.0f} % below the {before:.2f} of the run kept in {given.kept}", file=sys.stderr)
    sys.exit(1 if lost else 0)


if __name__ == "__main__":
    main()
