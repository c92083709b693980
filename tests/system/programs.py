"""The real programs, as a user starts them: a server on free ports, the robot's agent, the command line."""

import contextlib
import json
import os
import pathlib
import random
import select
import shutil
import signal
import subprocess
import tempfile
import unittest

BIN = pathlib.Path(os.environ["SOUNDMAP_BIN"])
DRIVES = pathlib.Path(os.environ["SOUNDMAP_DRIVES"])
SOURCE = pathlib.Path(os.environ["SOUNDMAP_SOURCE_DIR"])
START_TIMEOUT_S = 60
COMMAND_TIMEOUT_S = 300


class Server:
    """A soundmap-server on a data folder; `address` once it serves."""

    def __init__(self, data_dir, *arguments, preexec=None):
        self.data_dir = pathlib.Path(data_dir)
        self.log_path = pathlib.Path(str(data_dir) + ".log")
        self.log = open(self.log_path, "ab")
        self.process = subprocess.Popen(
            [BIN / "soundmap-server", "--data-dir", str(data_dir), "--grpc", "127.0.0.1:0",
             "--http", "127.0.0.1:0", *arguments],
            stdout=subprocess.PIPE, stderr=self.log, preexec_fn=preexec)
        readable, _, _ = select.select([self.process.stdout], [], [], START_TIMEOUT_S)
        line = self.process.stdout.readline() if readable else b""
        if not line:
            self.kill()
            raise AssertionError("the server did not start: " + self.log_path.read_text()[-2000:])
        ready = json.loads(line)
        assert ready["event"] == "ready", ready
        self.address = ready["grpc"]
        self.http_address = ready["http"]

    def alive(self):
        return self.process.poll() is None

    def stop(self, within_s=30):
        """SIGTERM; the exit status."""
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(timeout=within_s)
        finally:
            self.close()

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.close()

    def close(self):
        self.process.stdout.close()
        self.log.close()


def arguments_of(program, *arguments):
    return [str(BIN / program), *map(str, arguments)]


def run(server, program, *arguments):
    """Runs a program against the server to its end."""
    environment = dict(os.environ)
    if server is not None:
        environment["SOUNDMAP_SERVER"] = server.address
    return subprocess.run(arguments_of(program, *arguments), env=environment, capture_output=True,
                          text=True, timeout=COMMAND_TIMEOUT_S)


def start(server, program, *arguments):
    return subprocess.Popen(arguments_of(program, *arguments),
                            env=dict(os.environ, SOUNDMAP_SERVER=server.address),
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def start_pose(drive):
    pose = json.loads(drive.with_suffix("").with_suffix(".truth.json").read_text())["start_pose"]
    return ",".join(repr(value) for value in pose)


def random_moments(count):
    """So many shares of a drive, or SOUNDMAP_KILLS, the same ones for one SOUNDMAP_SEED; none so late that the drive could be over."""
    generator = random.Random(int(os.environ.get("SOUNDMAP_SEED", 1)))
    return sorted(generator.uniform(0.02, 0.7) for _ in range(int(os.environ.get("SOUNDMAP_KILLS", count))))


class ProgramTest(unittest.TestCase):
    """Each test has a folder of its own and servers that end with it."""

    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="soundmap-system-"))
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)

    def server(self, name="data", *arguments, preexec=None):
        server = Server(self.folder / name, *arguments, preexec=preexec)
        self.addCleanup(lambda: server.kill() if server.alive() else None)
        return server

    def ok(self, server, program, *arguments):
        result = run(server, program, *arguments)
        self.assertEqual(result.returncode, 0,
                         f"{program} {' '.join(map(str, arguments))}: {result.stderr}")
        return result.stdout

    def refused(self, server, program, *arguments, status=1, says):
        """The program ends with `status` and one sentence with `says` in it."""
        result = run(server, program, *arguments)
        self.assertEqual(result.returncode, status, result.stdout + result.stderr)
        lines = [line for line in result.stderr.strip().splitlines() if line.strip()]
        self.assertEqual(len(lines), 1, result.stderr)
        self.assertIn(says, lines[0])
        return lines[0]

    def make_site(self, server, site="site", mapping=None, *, profile="default", bands=()):
        """A site with the geometric map of a mapping drive."""
        mapping = mapping or DRIVES / "mapping.mcap"
        self.ok(server, "soundmap", "site", "create", site, "--profile", profile, *(f"--band={band}" for band in bands))
        self.ok(server, "soundmap-robot", "replay", mapping, "--site", site, "--robot", "mapper",
                "--purpose", "mapping", "--speed", "max", f"--initial-pose={start_pose(mapping)}")
        self.ok(server, "soundmap", "map", "build", site)

    def replay_arguments(self, drive, site="site", robot="robot", pose_of=None, speed="max", unknown_start=False):
        start = [] if unknown_start else [f"--initial-pose={start_pose(pose_of or drive)}"]
        return ["replay", drive, "--site", site, "--robot", robot, "--speed", speed, *start]

    def replay(self, server, drive, site="site", robot="robot", pose_of=None, unknown_start=False):
        return self.ok(server, "soundmap-robot",
                       *self.replay_arguments(drive, site, robot, pose_of, unknown_start=unknown_start))

    def sources_json(self, server, site="site"):
        return self.ok(server, "soundmap", "sources", site, "--format", "json")

    def source_history_json(self, server, site="site", band=""):
        """With everything that is kept of each, also of those that are gone."""
        return self.ok(server, "soundmap", "sources", site, "--band", band, "--since", "1", "--until", "2100-01-01", "--format", "json")

    def full_map(self, server, site="site", band=""):
        """L, M and U of every voxel, as bytes."""
        path = self.folder / "full.ot"
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        self.ok(server, "soundmap", "map", "export", site, "--what", "sound", "--format", "ot",
                "--full", "--band", band, "-o", path)
        return path.read_bytes()

    def sessions(self, server, site="site"):
        return json.loads(self.ok(server, "soundmap", "sessions", site, "--format", "json"))

    def session_list(self, server, site="site"):
        """The listening drives."""
        sessions = self.sessions(server, site)
        sessions = sessions["sessions"] if isinstance(sessions, dict) else sessions
        return [session for session in sessions if not session["robot"].endswith("mapper")]

    def processed(self, server):
        return sum(int(session["processed"]) for session in self.session_list(server))

    def durable(self, server, at_least=0):
        durable = sum(int(session["durable"]) for session in self.session_list(server))
        self.assertGreaterEqual(durable, at_least, "frames that were acknowledged as durable are gone")
        return durable

    def replay_while_killing(self, server, frames, arguments):
        """Replays a drive of so many frames through crashes of the server, the robot's program or both at random moments; returns the last
        server. What was said to be durable stays so."""
        moments = random_moments(5)
        interrupted = 0
        durable = 0
        for i, moment in enumerate(moments):
            # At a pace, so that the frames do not run ahead of what is processed.
            robot = start(server, "soundmap-robot", *arguments, "--connect-timeout", "5")
            while self.processed(server) < frames * moment and robot.poll() is None:
                durable = self.durable(server, at_least=durable)
            interrupted += robot.poll() is None
            victim = ("server", "both", "robot")[i % 3]
            if victim != "robot":
                server.kill()
            if victim != "server":
                robot.kill()
            robot.terminate()
            robot.communicate()
            if victim != "robot":
                server = self.server(server.data_dir.name)
        durable = self.durable(server, at_least=durable)
        self.assertGreaterEqual(interrupted, len(moments) * 3 // 5)
        self.ok(server, "soundmap-robot", *arguments)
        self.assertEqual(self.processed(server), frames)
        return server
