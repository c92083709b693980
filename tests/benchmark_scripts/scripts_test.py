"""The scripts that run benchmarks and judge them, on figures of which the outcome is known."""

import contextlib
import io
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

BENCHMARK = pathlib.Path(__file__).resolve().parent.parent / "benchmark"
sys.path.insert(0, str(BENCHMARK))
import server  # noqa: E402
import table  # noqa: E402


def document(**cpu_times_ms):
    """A program's file; `group__method` for a benchmark."""
    return {"context": {"date": "2026-01-01T00:00:00", "num_cpus": 2, "mhz_per_cpu": 2600, "cpu": "X", "compiler": "c"},
            "benchmarks": [{"name": name, "run_name": name.replace("__", "/"), "family_index": index,
                            "aggregate_name": "median", "cpu_time": ms, "real_time": ms, "time_unit": "ms"}
                           for index, (name, ms) in enumerate(cpu_times_ms.items())]}


SERVER = {"context": {"date": "2026-01-01T00:00:00", "num_cpus": 2}, "empty_memory_mb": 40.0,
          "full_speed": {"robots": 8, "seconds": 60, "robots_per_core": 50.0, "robots_per_core_of_runs": [49.0, 50.0, 52.0],
                         "wire_bytes_per_s": 8e5, "ms_per_robot_second": {"map": 5.0, "other": 15.0}}}


class Table(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def folder_of(self, name, **documents):
        folder = self.folder / name
        folder.mkdir()
        for program, content in documents.items():
            (folder / f"{program}.json").write_text(json.dumps(content))
        return folder

    def run_table(self, *arguments):
        return subprocess.run([sys.executable, BENCHMARK / "table.py", *arguments], capture_output=True, text=True)

    def test_a_method_is_named_before_the_arguments(self):
        self.assertEqual(table.group_and_method("a/ours/200/60"), ("a/200/60", "ours"))
        self.assertEqual(table.group_and_method("a/ours"), ("a", "ours"))

    def test_ratios_are_peer_over_ours(self):
        groups = table.medians({"a": document(a__ours=2.0, a__peer=5.0, b__alone=1.0)})
        self.assertEqual(table.ratios(groups), {("a", "peer"): 2.5})

    def test_the_page_has_both_tables(self):
        folder = self.folder_of("run", a=document(a__ours=2.0, a__peer=5.0), server=SERVER)
        page = self.run_table(folder).stdout
        self.assertIn("2.50", page)
        self.assertIn("50.0 (49.0 to 52.0)", page)
        self.assertRegex(page, r"\| map +\| 5\.00 +\| 25\.0 %")

    def test_a_run_is_kept_between_its_marks(self):
        run = self.folder_of("run", a=document(a__ours=2.0, a__peer=5.0), server=SERVER)
        kept = self.folder_of("kept")
        (kept / "README.md").write_text("before\n<!-- begin table -->\nold\n<!-- end table -->\nafter\n")
        self.assertEqual(self.run_table(run, "--keep", kept).returncode, 0)
        page = (kept / "README.md").read_text()
        self.assertTrue(page.startswith("before\n") and page.endswith("after\n"), page)
        self.assertNotIn("old", page)
        self.assertIn("Machine: X, 2 cores at 2600 MHz", page)
        self.assertEqual(json.loads((kept / "server.json").read_text())["empty_memory_mb"], 40.0)


class Server(unittest.TestCase):
    def test_metrics_are_read(self):
        text = "# HELP a b\n# TYPE a counter\na 3\nb_total{stage=\"map\"} 1.5e-3\n"
        self.assertEqual(server.parse_metrics(text), {"a": 3.0, "b_total/map": 0.0015})
        with self.assertRaises(ValueError):
            server.parse_metrics("what is this\n")

    def test_other_is_what_no_stage_counts(self):
        metrics = {"soundmap_stage_cpu_seconds_total/map": 1.0, "soundmap_stage_cpu_seconds_total/cast": 2.0,
                   "process_cpu_seconds_total": 3.5}
        self.assertEqual(server.stage_seconds(metrics), {"map": 1.0, "cast": 2.0, "other": 0.5})

    def test_wrong_arguments_are_refused(self):
        for arguments in (["bin"], ["bin", "work", "out", "--robots", "0"], ["bin", "work", "out", "--streaming", "-1"]):
            with self.subTest(arguments), contextlib.redirect_stderr(io.StringIO()):
                result = subprocess.run([sys.executable, BENCHMARK / "server.py", *arguments], capture_output=True,
                                        text=True, cwd=self.enterContext(tempfile.TemporaryDirectory()))
                self.assertEqual(result.returncode, 2, result.stderr)


if __name__ == "__main__":
    unittest.main()
