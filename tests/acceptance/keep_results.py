#!/usr/bin/env python3
"""keep_results.py FOLDER FILE: the summaries of all runs of source_accuracy in the folder, in one file."""

import json
import pathlib
import sys

folder, kept = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
kept.write_text(json.dumps({run.stem: json.loads(run.read_text()) for run in sorted(folder.glob("*.json"))
                            if not run.name.endswith(".truth.json")}, indent=1) + "\n")
