#!/usr/bin/env python3
"""Measures a whole server: real programs, a simulated drive, gRPC on loopback.

usage: server.py BIN WORK OUT [--robots N] [--seconds S] [--repetitions R] ...

BIN holds the programs, WORK keeps the drives and takes the servers' data, OUT is the JSON file to
write. The server has the first core of this machine to itself, the robots and apps take the others.
"""
import argparse
import contextlib
import datetime
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time
import urllib.request

SYSTEM_TESTS = pathlib.Path(__file__).resolve().parent.parent / "system"
SCENE = "grill_room"
ROOM_M = ("10", "7", "2.7")  # of the scene
SITE = "site"


def parse_metrics(text):
    """{name: value} of Prometheus' text format; a metric with one label is NAME/VALUE_OF_THE_LABEL."""
    metrics = {}
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        match = re.fullmatch(r'([a-z_]+)(?:\{[a-z_]+="([^"]*)"\})? (\S+)', line)
        if not match:
            raise ValueError(f"not a metric: {line!r}")
        name, label, value = match.groups()
        metrics[name if label is None else f"{name}/{label}"] = float(value)
    return metrics


def difference(after, before):
    return {name: value - before.get(name, 0.0) for name, value in after.items()}


def cores():
    """(of the server, of the clients)"""
    usable = sorted(os.sched_getaffinity(0))
    return usable[:1], usable[1:] or usable


def stage_seconds(metrics):
    """{stage: CPU seconds}; `other` is what no stage counts: gRPC, the kernel's part of it, RocksDB's own threads."""
    prefix = "soundmap_stage_cpu_seconds_total/"
    stages = {name[len(prefix):]: value for name, value in metrics.items() if name.startswith(prefix)}
    stages["other"] = max(0.0, metrics["process_cpu_seconds_total"] - sum(stages.values()))
    return stages


class Bench:
    def __init__(self, given):
        self.given = given
        self.work = given.work
        self.is_mapped = False
        os.environ.update(SOUNDMAP_BIN=str(given.bin), SOUNDMAP_DRIVES=str(given.work),
                          SOUNDMAP_SOURCE_DIR=str(SYSTEM_TESTS.parent.parent))
        sys.path.insert(0, str(SYSTEM_TESTS))
        import programs  # reads the environment
        self.programs = programs

    def drive(self, name, *arguments):
        """The path of a drive, made unless it is there and newer than the simulator."""
        path = self.work / f"{name}.mcap"
        robot = self.given.bin / "soundmap-robot"
        if not path.exists() or path.stat().st_mtime < robot.stat().st_mtime:
            path.unlink(missing_ok=True)
            subprocess.run([robot, "simulate", SCENE, "--out", path, *arguments], check=True,
                           stdout=subprocess.DEVNULL)
        return path

    def start(self, data, cores_of_server):
        return self.programs.Server(data, "--threads", str(len(cores_of_server)), "--log-level", "warning",
                                    preexec=lambda: os.sched_setaffinity(0, cores_of_server))

    def mapped(self):
        """The data of a server whose site has its geometric map, made once a run."""
        data = self.work / "mapped"
        if not self.is_mapped:
            shutil.rmtree(data, ignore_errors=True)
            mapping = self.drive("mapping", "--mapping")
            server = self.start(data, sorted(os.sched_getaffinity(0)))
            try:
                self.ok(server, "soundmap", "site", "create", SITE)
                self.ok(server, "soundmap-robot", *self.replay(mapping, "mapper", "max"), "--purpose", "mapping")
                self.ok(server, "soundmap", "map", "build", SITE)
            finally:
                server.stop()
            self.is_mapped = True
        return data

    @contextlib.contextmanager
    def server(self, cores_of_server):
        """A server whose site has its geometric map and nothing else."""
        data = self.work / "data"
        shutil.rmtree(data, ignore_errors=True)
        shutil.copytree(self.mapped(), data)
        server = self.start(data, cores_of_server)
        try:
            yield server
        finally:
            server.stop()

    def ok(self, server, program, *arguments):
        result = self.programs.run(server, program, *arguments)
        if result.returncode != 0:
            sys.exit(f"{program} {' '.join(map(str, arguments))}: {result.stderr}")
        return result.stdout

    def replay(self, drive, robot, speed):
        return ["replay", str(drive), "--site", SITE, "--robot", robot, "--speed", speed,
                f"--initial-pose={self.programs.start_pose(drive)}"]

    def start_robots(self, server, drive, count, speed, cores_of_clients):
        environment = dict(os.environ, SOUNDMAP_SERVER=server.address)
        return [subprocess.Popen([self.given.bin / "soundmap-robot", *self.replay(drive, f"robot{i}", speed)],
                                 env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                                 preexec_fn=lambda: os.sched_setaffinity(0, cores_of_clients))
                for i in range(count)]

    def metrics(self, server):
        with urllib.request.urlopen(f"http://{server.http_address}/metrics", timeout=10) as answer:
            return parse_metrics(answer.read().decode())

    def full_speed(self, robots, seconds, cores_of_server, cores_of_clients):
        """One replay of a drive by so many robots as fast as it goes; what it cost."""
        drive = self.drive(f"drive_{seconds}", "--seconds", str(seconds))
        with self.server(cores_of_server) as server:
            before = self.metrics(server)
            begin = time.monotonic()
            for robot in self.start_robots(server, drive, robots, "max", cores_of_clients):
                _, trouble = robot.communicate()
                if robot.returncode != 0:
                    sys.exit(f"a replay failed: {trouble}")
            wall_s = time.monotonic() - begin
            spent = difference(self.metrics(server), before)
        cpu_s = spent["process_cpu_seconds_total"]
        return {
            "robots_per_core": seconds * robots / cpu_s,
            "robots_by_wall": seconds * robots / wall_s,
            "cpu_s": cpu_s,
            "wall_s": wall_s,
            "ms_per_robot_second": {stage: 1e3 * value / (seconds * robots)
                                    for stage, value in stage_seconds(spent).items()},
            "wire_bytes_per_s": spent["soundmap_received_bytes_total"] / (seconds * robots),
            "recording_bytes_per_s": drive.stat().st_size / seconds,
        }

    def median_full_speed(self, robots, seconds, cores_of_server, cores_of_clients):
        runs = [self.full_speed(robots, seconds, cores_of_server, cores_of_clients)
                for _ in range(self.given.repetitions)]
        middle = sorted(runs, key=lambda run: run["robots_per_core"])[len(runs) // 2]
        return {"robots": robots, "seconds": seconds, **middle,
                "robots_per_core_of_runs": [run["robots_per_core"] for run in runs]}

    def streaming(self, robots, seconds):
        """Robots that stream as they drive: memory, load, and how long apps wait for an answer."""
        cores_of_server, cores_of_clients = cores()
        settle_s = 5
        drive = self.drive(f"drive_{seconds + 2 * settle_s}", "--seconds", str(seconds + 2 * settle_s))
        with self.server(cores_of_server) as server:
            before = self.metrics(server)
            fleet = self.start_robots(server, drive, robots, "1", cores_of_clients)
            time.sleep(settle_s)
            begin = time.monotonic()
            at_begin = self.metrics(server)
            result = subprocess.run(
                [self.given.bin / "query_latency", "--site", SITE, "--seconds", str(seconds), "--room", *ROOM_M],
                env=dict(os.environ, SOUNDMAP_SERVER=server.address), capture_output=True, text=True,
                preexec_fn=lambda: os.sched_setaffinity(0, cores_of_clients))
            at_end = self.metrics(server)
            wall_s = time.monotonic() - begin
            for robot in fleet:
                robot.terminate()
                robot.communicate()
            if result.returncode != 0:
                sys.exit(result.stderr)
        spent = difference(at_end, at_begin)
        memory = "process_resident_memory_bytes"
        return {"robots": robots, "seconds": seconds,
                "core_share": spent["process_cpu_seconds_total"] / wall_s,
                "received_bytes_per_robot_second": spent["soundmap_received_bytes_total"] / (wall_s * robots),
                "memory_before_mb": before[memory] / 1e6,
                "memory_per_robot_mb": (at_end[memory] - before[memory]) / robots / 1e6,
                "queries": json.loads(result.stdout)}

    def empty_memory_mb(self):
        data = self.work / "empty"
        shutil.rmtree(data, ignore_errors=True)
        server = self.programs.Server(data, "--log-level", "warning")
        try:
            return self.metrics(server)["process_resident_memory_bytes"] / 1e6
        finally:
            server.stop()

    def run(self):
        given = self.given
        cores_of_server, cores_of_clients = cores()
        result = {"context": {"date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
                              "num_cpus": os.cpu_count(), "cpu": given.cpu, "compiler": given.compiler,
                              "scene": SCENE, "cores_of_server": 1},
                  "empty_memory_mb": self.empty_memory_mb(),
                  "full_speed": self.median_full_speed(given.robots, given.seconds, cores_of_server, cores_of_clients)}
        both = sorted(os.sched_getaffinity(0))[:2]
        if len(both) == 2:
            # The robots and apps share the two cores with the server.
            result["two_cores"] = self.median_full_speed(given.robots, given.seconds, both, both)
            result["two_cores"]["speed_up"] = (result["two_cores"]["robots_by_wall"] /
                                               result["full_speed"]["robots_by_wall"])
        result["growth_robots"] = [
            {"robots": robots, **self.full_speed(robots, given.growth_seconds, cores_of_server, cores_of_clients)}
            for robots in given.growth]
        if given.streaming > 0:
            result["streaming"] = self.streaming(given.streaming, given.streaming_seconds)
        return result


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("bin", type=pathlib.Path)
    arguments.add_argument("work", type=pathlib.Path)
    arguments.add_argument("out", type=pathlib.Path)
    arguments.add_argument("--robots", type=int, default=8, help="that replay at full speed (%(default)s)")
    arguments.add_argument("--seconds", type=int, default=60, help="of their drive (%(default)s)")
    arguments.add_argument("--repetitions", type=int, default=3, help="of the replay (%(default)s)")
    arguments.add_argument("--streaming", type=int, default=20, help="robots that stream while apps ask; 0: none (%(default)s)")
    arguments.add_argument("--streaming-seconds", type=int, default=20, help="how long apps ask (%(default)s)")
    arguments.add_argument("--growth", type=int, nargs="*", default=[1, 4, 16, 64],
                           help="numbers of robots whose cost is measured (%(default)s)")
    arguments.add_argument("--growth-seconds", type=int, default=10, help="of their drive (%(default)s)")
    arguments.add_argument("--cpu", default="unknown processor")
    arguments.add_argument("--compiler", default="unknown compiler")
    given = arguments.parse_args()
    for name in ("robots", "seconds", "repetitions", "streaming_seconds", "growth_seconds"):
        if getattr(given, name) < 1:
            arguments.error(f"--{name.replace('_', '-')} must be 1 or more")
    if any(robots < 1 for robots in given.growth):
        arguments.error("--growth takes numbers of robots")
    if given.streaming < 0:
        arguments.error("--streaming must be 0 or more")
    given.bin = given.bin.resolve()
    given.work.mkdir(parents=True, exist_ok=True)
    given.work = given.work.resolve()
    result = Bench(given).run()
    given.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
