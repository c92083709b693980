#!/usr/bin/python3
"""Many robots, idle sessions and watchers on one server for some time, then a crash.

usage: soak.py BIN WORK OUT [--minutes N] [--robots N] [--sessions N] [--watchers N] ...

Real programs: robots that replay a simulated drive as fast as they drove it, one drive after the other, some of them the real agent, the others
a program that sends what an agent has made ready; sessions whose robots send nothing; watchers of its sources and robots. Writes OUT.json with the figures and, unless told otherwise, OUT.svg with memory and queues over time. Ends with 1
where a robot, an idle session or a watcher was cut, a frame that was durable is gone, or the server's memory grew by more than it may.
"""
import argparse
import json
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

TESTS = pathlib.Path(__file__).resolve().parent.parent
SITE = "site"
LAG = "soundmap_durable_lag_seconds_bucket/"


def drive_until(stop, programs, server, drive, index, troubles):
    """One robot's drives, one after the other."""
    while not stop.is_set() and not troubles:
        robot = programs.start(server, "soundmap-robot", "replay", drive, "--site", SITE, "--robot", f"robot{index}", "--new-session",
                               f"--initial-pose={programs.start_pose(drive)}")
        while robot.poll() is None and not stop.wait(0.2):
            pass
        if stop.is_set():
            robot.terminate()
        _, said = robot.communicate()
        if robot.returncode != 0 and not stop.is_set():
            troubles.append(f"robot{index}: {said.strip()}")


class Crowd:
    """Many peers of the server in a process of their own, until end()."""

    def __init__(self, *command):
        self.process = subprocess.Popen([str(part) for part in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if json.loads(self.process.stdout.readline() or "{}").get("event") != "ready":
            sys.exit(f"{command} did not begin")

    def end(self):
        """What it counted; `ended_early` are those that the server cut."""
        self.process.stdin.close()
        counted = json.loads(self.process.stdout.readline())
        self.process.wait()
        return counted


def lag_quantile(buckets, share):
    """The upper bound of the bucket in which this share of the frames ends, in seconds."""
    bounds = sorted((float(name[len(LAG):].replace("+Inf", "inf")), count) for name, count in buckets.items())
    total = bounds[-1][1]
    return next(bound for bound, count in bounds if count >= share * total)


def growth_per_minute(samples, field):
    """From the middle third of the samples to the last one, of their medians: what comes and goes with the load is no growth."""
    third = len(samples) // 3
    middle, last = (statistics.median(s[field] for s in samples[i * third:(i + 1) * third]) for i in (1, 2))
    return (last - middle) / (samples[-1]["time_s"] / 60 / 3)


def sync_s(file):
    """How long the disk takes to sync a file that grew, beside what the server asks of it: the lag of what it calls durable is made of such."""
    begin = time.monotonic()
    file.write(b"x" * 4096)
    os.fdatasync(file.fileno())
    return time.monotonic() - begin


def plot(samples, path):
    import matplotlib  # of Debian's packages, as the first line's interpreter is
    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "soundmap", "font.size": 9})
    from matplotlib import pyplot
    figure, axes = pyplot.subplots(4, sharex=True, figsize=(8, 9), layout="constrained")
    times = [s["time_s"] / 60 for s in samples]
    for axis, field, label in zip(axes, ("memory_mb", "in_flight_mb", "backlog_frames", "cores"),
                                  ("memory of the server [MB]", "waits for the disk [MB]", "waits for the map [frames]",
                                   "processor of the server [cores]")):
        axis.plot(times, [s[field] for s in samples], linewidth=0.8)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time [min]")
    figure.savefig(path, metadata={"Date": None})


class Soak:
    def __init__(self, given):
        self.given = given
        os.environ.update(SOUNDMAP_BIN=str(given.bin.resolve()), SOUNDMAP_DRIVES=str(given.work.resolve()),
                          SOUNDMAP_SOURCE_DIR=str(TESTS.parent))
        sys.path[:0] = [str(TESTS / "system"), str(TESTS / "benchmark")]
        import programs  # reads the environment
        from server import parse_metrics
        self.programs = programs
        self.parse_metrics = parse_metrics
        self.troubles = []

    def ok(self, server, *arguments):
        result = self.programs.run(server, *arguments)
        if result.returncode != 0:
            sys.exit(f"{' '.join(map(str, arguments))}: {result.stderr}")
        return result.stdout

    def metrics(self, server):
        with urllib.request.urlopen(f"http://{server.http_address}/metrics", timeout=60) as answer:
            return self.parse_metrics(answer.read().decode())

    def sessions(self, server):
        """Of those that drive."""
        found = json.loads(self.ok(server, "soundmap", "sessions", SITE, "--format", "json"))["sessions"]
        return {session["id"]: session for session in found if session["robot"].startswith(("robot", "fleet"))}

    def drive(self, name, *arguments):
        path = (self.given.drives or self.given.work) / f"{name}.mcap"
        if not path.exists():
            subprocess.run([self.given.bin / "soundmap-robot", "simulate", "grill_room", "--out", path, *arguments],
                           check=True, stdout=subprocess.DEVNULL)
        return path

    def serve(self, data):
        # All robots and watchers come from one address.
        return self.programs.Server(data, "--log-level", "warning", "--max-calls-per-s", "10000")

    def sample(self, server, minutes):
        """What the server tells of itself, once a second."""
        samples = []
        begin = time.monotonic()
        before, last = self.metrics(server), begin
        with tempfile.TemporaryFile(dir=self.given.work, buffering=0) as file:
            while time.monotonic() - begin < 60 * minutes and not self.troubles:
                time.sleep(1)
                disk_s = sync_s(file)
                values, now = self.metrics(server), time.monotonic()
                samples.append({"time_s": now - begin, "memory_mb": values["process_resident_memory_bytes"] / 1e6,
                                "in_flight_mb": values["soundmap_in_flight_bytes"] / 1e6,
                                "backlog_frames": values["soundmap_backlog_frames"],
                                "cores": (values["process_cpu_seconds_total"] - before["process_cpu_seconds_total"]) / (now - last),
                                "streams": values["soundmap_streams"], "watches": values["soundmap_watches"], "disk_sync_s": disk_s})
                before, last = values, now
        return samples

    def await_caught_up(self, server):
        """How long it takes until no frame waits for the map."""
        begin = time.monotonic()
        while self.metrics(server)["soundmap_backlog_frames"] > 0:
            time.sleep(0.1)
        return time.monotonic() - begin

    def run(self):
        given = self.given
        given.work.mkdir(parents=True, exist_ok=True)
        mapping, drive = self.drive("mapping", "--mapping"), self.drive("drive", "--seconds", "60")
        data = given.work / "data"
        shutil.rmtree(data, ignore_errors=True)
        server = self.serve(data)
        try:
            self.ok(server, "soundmap", "site", "create", SITE)
            # Fifty robots fill a disk within the hour.
            self.ok(server, "soundmap", "site", "set", SITE, "--keep-frames", "2min")
            self.ok(server, "soundmap-robot", "replay", mapping, "--site", SITE, "--robot", "mapper", "--purpose", "mapping",
                    "--speed", "max", f"--initial-pose={self.programs.start_pose(mapping)}")
            self.ok(server, "soundmap", "map", "build", SITE)
            empty = self.metrics(server)
            crowd = self.programs.BIN / "crowd"
            crowds = [Crowd(crowd, server.address, SITE, given.sessions, 0), Crowd(crowd, server.address, SITE, 0, given.watchers)]
            crowded = self.metrics(server)
            agents = min(given.robots, given.agents)

            stop = threading.Event()
            robots = [threading.Thread(target=drive_until, args=(stop, self.programs, server, drive, i, self.troubles))
                      for i in range(agents)]
            begin = time.monotonic()
            for robot in robots:
                robot.start()
            crowds.append(Crowd(self.programs.BIN / "fleet", server.address, SITE, drive, self.programs.start_pose(drive),
                                given.robots - agents))
            samples = self.sample(server, given.minutes)
            end, sessions, wall_s = self.metrics(server), self.sessions(server), time.monotonic() - begin
            data_bytes = sum(path.stat().st_size for path in data.rglob("*") if path.is_file())
            counted = [crowd.end() for crowd in crowds]
            for who, counts in zip(("idle sessions", "watchers", "robots"), counted):
                if counts["ended_early"]:
                    self.troubles.append(f"{counts['ended_early']} {who} were cut: {counts['error']}")
            stop.set()
            server.kill()
            for robot in robots:
                robot.join()
            begin = time.monotonic()
            server = self.serve(data)
            recovery_s = time.monotonic() - begin
            after = self.sessions(server)
            backlog = self.metrics(server)["soundmap_backlog_frames"]
            caught_up_s = self.await_caught_up(server)
        finally:
            server.kill()
        lost = [name for name, session in sessions.items() if after[name]["received"] < session["durable"]]
        if lost:
            self.troubles.append(f"durable frames of {lost} are gone")
        memory = [sample["memory_mb"] for sample in samples]
        syncs = sorted(sample["disk_sync_s"] for sample in samples)
        crowded_mb = crowded["process_resident_memory_bytes"] / 1e6
        if given.max_growth_mb is not None and max(memory) - crowded_mb > given.max_growth_mb:
            self.troubles.append(f"the memory of the server grew by {max(memory) - crowded_mb:.0f} MB")
        lags = {name: value - crowded.get(name, 0.0) for name, value in end.items() if name.startswith(LAG)}
        driven_s = sum(s["last_frame_time_ns"] - s["first_frame_time_ns"] for s in sessions.values() if s["first_frame_time_ns"]) / 1e9
        figures = {
            "robots": given.robots, "idle_sessions": given.sessions, "watchers": given.watchers, "minutes": given.minutes,
            "processors": len(os.sched_getaffinity(0)),
            "memory_of_the_idle_mb": crowded_mb - empty["process_resident_memory_bytes"] / 1e6,
            "memory_mb": {"without_robots": crowded_mb, "last": memory[-1], "most": max(memory),
                          "growth_per_minute": growth_per_minute(samples, "memory_mb")},
            "agents": agents,
            "in_flight_mb": {"mean": sum(s["in_flight_mb"] for s in samples) / len(samples),
                             "most": max(s["in_flight_mb"] for s in samples)},
            "cores_of_the_server": sum(s["cores"] for s in samples) / len(samples),
            "received_mb": (end["soundmap_received_bytes_total"] - crowded["soundmap_received_bytes_total"]) / 1e6,
            "share_of_real_time": driven_s / (given.robots * wall_s),
            "durable_lag_s": {"p50": lag_quantile(lags, 0.5), "p99": lag_quantile(lags, 0.99), "frames": max(lags.values())},
            "disk_sync_s": {"p50": statistics.median(syncs), "p99": syncs[int(0.99 * len(syncs))]},
            # From when the robot had the frame until it knew that it may forget it.
            "forget_after_s": {name: counted[2][f"{name}_s"] for name in ("p50", "p99", "most")},
            "without_credit_s": counted[2]["throttled_s"],
            "backlog_frames": {"last": samples[-1]["backlog_frames"], "most": max(s["backlog_frames"] for s in samples)},
            "watched_events": counted[1]["events"], "resyncs": counted[1]["resyncs"],
            "recovery": {"seconds": recovery_s, "sessions": given.sessions + len(sessions), "data_mb": data_bytes / 1e6,
                         "backlog_frames": backlog, "caught_up_s": caught_up_s},
            "troubles": self.troubles,
        }
        print(json.dumps(figures, indent=1))
        given.out.with_suffix(".json").write_text(json.dumps(figures, indent=1) + "\n")
        if not given.no_plot:
            plot(samples, given.out.with_suffix(".svg"))
        return not self.troubles


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path, help="takes the server's data, keeps simulated drives")
    parser.add_argument("out", type=pathlib.Path, help="without its suffix")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--agents", type=int, default=5, help="so many of the robots are the real program")
    parser.add_argument("--sessions", type=int, default=500)
    parser.add_argument("--watchers", type=int, default=200)
    parser.add_argument("--drives", type=pathlib.Path, help="folder with mapping.mcap and drive.mcap; without it they are simulated")
    parser.add_argument("--max-growth-mb", type=float, help="what the server's memory may grow by once the robots drive")
    parser.add_argument("--no-plot", action="store_true")
    sys.exit(0 if Soak(parser.parse_args()).run() else 1)


if __name__ == "__main__":
    main()
