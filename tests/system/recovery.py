#!/usr/bin/python3
"""How long a server that was killed takes until it serves again, after robots have driven for an hour.

usage: recovery.py BIN WORK OUT [--robots N] [--minutes N] [--drive-minutes N]

Robots send drives one after the other, as fast as the server takes them, until each has driven so long; in the middle of the last drive the
server is killed and started again. Writes OUT.json. Ends with 1 where it took more than 10 s, or a frame that was durable is gone.
"""
import argparse
import json
import pathlib
import shutil
import sys
import time

from soak import SITE, Soak

MOST_S = 10.0


class Recovery(Soak):
    def run(self):
        given = self.given
        given.work.mkdir(parents=True, exist_ok=True)
        seconds = round(60 * given.drive_minutes)
        mapping, drive = self.drive("mapping", "--mapping"), self.drive(f"drive_{seconds}", "--seconds", str(seconds))
        data = given.work / "data"
        shutil.rmtree(data, ignore_errors=True)
        server = self.serve(data)
        robots = []
        try:
            self.ok(server, "soundmap", "site", "create", SITE)
            self.ok(server, "soundmap-robot", "replay", mapping, "--site", SITE, "--robot", "mapper", "--purpose", "mapping",
                    "--speed", "max", f"--initial-pose={self.programs.start_pose(mapping)}")
            self.ok(server, "soundmap", "map", "build", SITE)
            for last in [False] * (round(given.minutes / given.drive_minutes) - 1) + [True]:
                before = set(self.sessions(server))
                robots = [self.programs.start(server, "soundmap-robot", "replay", drive, "--site", SITE, "--robot", f"robot{i}",
                                              "--new-session", "--speed", "max", f"--initial-pose={self.programs.start_pose(drive)}")
                          for i in range(given.robots)]
                if last:
                    break
                for robot in robots:
                    _, said = robot.communicate()
                    if robot.returncode != 0:
                        sys.exit(said)
            whole = max((session["processed"] for session in self.sessions(server).values()), default=0) if before else 10 * seconds
            while True:
                sessions = self.sessions(server)
                under_way = [session for name, session in sessions.items() if name not in before]
                if len(under_way) == given.robots and all(session["processed"] > 0.5 * whole for session in under_way):
                    break
                time.sleep(0.1)
            server.kill()
            for robot in robots:
                robot.kill()
                robot.communicate()
            robots = []
            begin = time.monotonic()
            server = self.serve(data)
            took_s = time.monotonic() - begin
            after, values = self.sessions(server), self.metrics(server)
            lost = [name for name, session in sessions.items() if after[name]["received"] < session["durable"]]
            driven_s = sum(session["last_frame_time_ns"] - session["first_frame_time_ns"] for session in sessions.values()) / 1e9
            figures = {
                "robots": given.robots, "hours_driven": driven_s / 3600, "drive_minutes": given.drive_minutes,
                "data_mb": sum(path.stat().st_size for path in data.rglob("*") if path.is_file()) / 1e6,
                "seconds": took_s, "processor_s": values["process_cpu_seconds_total"],
                "replayed_frames": values["soundmap_replayed_frames_total"], "backlog_frames": values["soundmap_backlog_frames"],
                "lost": lost,
            }
        finally:
            for robot in robots:
                robot.kill()
            server.kill()
            shutil.rmtree(data, ignore_errors=True)
        print(json.dumps(figures, indent=1))
        given.out.with_suffix(".json").write_text(json.dumps(figures, indent=1) + "\n")
        return not lost and took_s <= MOST_S


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path, help="takes the server's data, keeps simulated drives")
    parser.add_argument("out", type=pathlib.Path, help="without its suffix")
    parser.add_argument("--drives", type=pathlib.Path, help="folder with mapping.mcap and drive_SECONDS.mcap; without it they are simulated")
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=60.0, help="that each robot drives")
    parser.add_argument("--drive-minutes", type=float, default=1.4, help="of one drive; the simulated one ends after 88 s")
    sys.exit(0 if Recovery(parser.parse_args()).run() else 1)


if __name__ == "__main__":
    main()
