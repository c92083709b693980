"""How frames reach the server over a network that fails: coded, spooled, cut, with the agent killed."""

import json
import select
import math
import socket
import threading
import time
import unittest
import urllib.request

from programs import DRIVES, ProgramTest, random_moments, start, start_pose

SHORT = DRIVES / "short.mcap"


class Link:
    """A TCP proxy to the server. While it is down, nobody gets through and no connection lives; while it is stalled, connections live and
    nothing gets through. `bytes_per_s`: that each connection carries."""

    def __init__(self, up=True):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        self.target = None
        self.is_up = up
        self.bytes_per_s = None
        self.flows = threading.Event()
        self.flows.set()
        self.lock = threading.Lock()
        self.sockets = []
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            with self.lock:
                if not self.is_up or self.target is None:
                    client.close()
                    continue
                host, port = self.target.rsplit(":", 1)
                try:
                    server = socket.create_connection((host, int(port)))
                except OSError:
                    client.close()
                    continue
                self.sockets += [client, server]
            threading.Thread(target=self.forward, args=(client, server), daemon=True).start()

    def forward(self, client, server):
        other = {client: server, server: client}
        try:
            while True:
                for end in select.select([client, server], [], [])[0]:
                    data = end.recv(1 << 14)
                    if not data:
                        raise OSError
                    self.flows.wait()
                    if self.bytes_per_s:
                        time.sleep(len(data) / self.bytes_per_s)
                    other[end].sendall(data)
        except (OSError, ValueError):
            client.close()
            server.close()

    def down(self):
        with self.lock:
            self.is_up = False
            for end in self.sockets:
                try:
                    end.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass
            self.sockets = []

    def up(self):
        with self.lock:
            self.is_up = True

    def close(self):
        self.listener.close()
        self.down()


class NetworkTest(ProgramTest):
    def link_to(self, server, up=True):
        link = Link(up)
        link.target = server.address
        self.addCleanup(link.close)
        return link

    def config(self, drive, address, *, speed=8, spool="", uplink=""):
        x, y, yaw = start_pose(drive).split(",")
        path = self.folder / "agent.toml"
        path.write_text(f"""
[server]
address = "{address}"
[robot]
name = "robot"
site = "site"
initial_x_m = {float(x)}
initial_y_m = {float(y)}
initial_yaw_deg = {float(yaw) * 57.29577951308232}
[source]
drive = "{drive}"
speed = {speed}
[uplink]
{uplink}
[spool]
dir = "{self.folder / 'spool'}"
{spool}
""")
        return path

    def undisturbed(self, drive):
        """Sources and map of the same session without anything in between."""
        server = self.server("undisturbed")
        self.make_site(server)
        agent = start(server, "soundmap-robot", "run", "--config",
                      self.config(drive, server.address, speed=0, uplink="live = false"))
        self.assertEqual(agent.wait(timeout=120), 0, agent.stderr.read())
        agent.communicate()
        results = self.sources_json(server), self.full_map(server), self.processed(server)
        server.kill()
        for path in sorted((self.folder / "spool").rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        return results

    def spooled(self):
        out = self.ok(None, "soundmap-robot", "spool", "--dir", self.folder / "spool", "--format", "json")
        return json.loads(out)["sessions"]

    def robot(self, server):
        robots = json.loads(self.ok(server, "soundmap", "robots", "site", "--format", "json"))["robots"]
        return next((robot for robot in robots if robot["id"] == "robot"), {"live": None})

    def test_coded_frames_give_the_same_map_as_raw_ones(self):
        server = self.server("coded")
        self.make_site(server)
        said = self.replay(server, SHORT)
        sources, voxels = self.sources_json(server), self.full_map(server)
        sent, raw = (float(part.split()[-1]) for part in said.split("; ")[-1].split(" MB")[:2])
        self.assertLess(sent, 0.65 * raw, said)
        server.kill()
        server = self.server("raw")
        self.make_site(server)
        self.ok(server, "soundmap-robot", *self.replay_arguments(SHORT), "--uncoded")
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)

    def test_the_agent_killed_and_the_link_cut_at_random_moments(self):
        sources, voxels, frames = self.undisturbed(SHORT)
        server = self.server("disturbed")
        self.make_site(server)
        link = self.link_to(server)
        config = self.config(SHORT, link.address)
        agent = None
        for i, moment in enumerate(random_moments(8)):
            if agent is None:
                agent = start(server, "soundmap-robot", "run", "--config", config)
            while self.processed(server) < frames * moment and agent.poll() is None:
                pass
            if i % 2 == 0:
                agent.kill()
                agent.communicate()
                agent = None
                # What the spool has let go is on the server's disk.
                for session in self.spooled():
                    self.durable(server, at_least=session["recorded"] - session["waiting"])
            else:
                link.down()
                link.up()
        agent = agent or start(server, "soundmap-robot", "run", "--config", config)
        self.assertEqual(agent.wait(timeout=120), 0, agent.stderr.read())
        agent.communicate()
        self.assertEqual(self.processed(server), frames)
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)
        # The drive again counts nothing: the spool knows that it was delivered.
        agent = start(server, "soundmap-robot", "run", "--config", config)
        self.assertEqual(agent.wait(timeout=60), 0)
        agent.communicate()
        self.assertEqual(self.full_map(server), voxels)

    def test_a_drive_without_a_network_waits_on_the_robot(self):
        sources, voxels, frames = self.undisturbed(SHORT)
        server = self.server("late")
        self.make_site(server)
        link = self.link_to(server, up=False)
        config = self.config(SHORT, link.address, speed=0)
        agent = start(server, "soundmap-robot", "run", "--config", config)
        while not (self.folder / "spool").exists() or not any(s["ended"] for s in self.spooled()):
            self.assertIsNone(agent.poll())
        (session,) = self.spooled()
        self.assertEqual((session["recorded"], session["waiting"]), (frames, frames))
        agent.terminate()  # and the robot is switched off
        self.assertEqual(agent.wait(timeout=20), 0)
        agent.communicate()
        link.up()
        agent = start(server, "soundmap-robot", "run", "--config", config)
        self.assertEqual(agent.wait(timeout=120), 0, agent.stderr.read())
        agent.communicate()
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)
        (session,) = self.spooled()
        self.assertTrue(session["delivered"])
        self.assertEqual(session["bytes"], 0)

    def test_what_a_full_spool_dropped_is_shown_by_the_server(self):
        server = self.server()
        self.make_site(server)
        link = self.link_to(server, up=False)
        config = self.config(SHORT, link.address, speed=0, spool='max_gb = 0.002\nwhen_full = "drop_oldest"')
        agent = start(server, "soundmap-robot", "run", "--config", config)
        while not (self.folder / "spool").exists() or not any(s["ended"] for s in self.spooled()):
            self.assertIsNone(agent.poll())
        link.up()
        self.assertEqual(agent.wait(timeout=120), 0, agent.stderr.read())
        agent.communicate()
        (spooled,) = self.spooled()
        (lost,) = spooled["gaps"]

        def check():
            (session,) = self.session_list(server)
            (gap,) = session["gaps"]
            self.assertEqual(gap["frames"], lost["frames"])
            self.assertEqual((gap["offset"], gap["from_ns"]), (0, 0))
            self.assertIn("the spool was full", gap["reason"])
            self.assertEqual(int(session["processed"]), spooled["recorded"] - lost["frames"] + 1)
            self.assertEqual(self.robot(server)["lost_frames"], lost["frames"])
            self.assertIn("the spool was full", self.ok(server, "soundmap", "sessions", "site"))

        check()
        with urllib.request.urlopen(f"http://{server.http_address}/metrics") as metrics:
            self.assertIn(f"soundmap_lost_frames_total {lost['frames']}\n", metrics.read().decode())
        server.kill()
        server = self.server()
        check()

    def await_live(self, server, agent, what):
        """The first live view of which `what` is true, and how many of the recorded frames the server has not had in its map then."""
        while True:
            self.assertIsNone(agent.poll(), "the drive is over")
            live = self.robot(server)["live"]
            if live and what(live):
                return live, live["recorded_frames"] - self.processed(server)

    def test_the_live_view_returns_while_the_backlog_drains(self):
        drive = DRIVES / "drive.mcap"
        sources, voxels, frames = self.undisturbed(drive)
        server = self.server("live")
        self.make_site(server)
        link = self.link_to(server)
        link.bytes_per_s = 300_000  # of 800,000 that come
        agent = start(server, "soundmap-robot", "run", "--config", self.config(drive, link.address, speed=1))
        seen = [self.await_live(server, agent, lambda live: live["map_from_base"])[0]]

        def cut_silently():
            link.flows.clear()

        def mend():
            link.flows.set()

        for cut, mended in ((cut_silently, mend), (link.down, link.up)):
            cut()
            # The agent has lost the server, and the drive goes on.
            before = seen[-1]["odometry_time_ns"]
            if cut is cut_silently:
                self.await_live(server, agent, lambda live: live["age_ns"] > 4e9)
            else:
                while self.robot(server)["live"]:
                    self.assertIsNone(agent.poll())
            mended()
            back = time.monotonic()
            live, behind = self.await_live(server, agent,
                                           lambda live: live["age_ns"] < 1e9 and live["odometry_time_ns"] > before)
            self.assertLess(time.monotonic() - back, 5.0)
            self.assertGreater(behind, 0)
            # It moves, ahead of what is localized, while the backlog drains.
            moved, behind = self.await_live(
                server, agent, lambda now: now["map_from_base"] and now["odometry_time_ns"] > live["odometry_time_ns"] + 5e8)
            self.assertNotEqual(moved["odom_from_base"], live["odom_from_base"])
            self.assertGreater(behind, 0)
            self.assertGreater(moved["odometry_time_ns"], moved["localized_time_ns"] + 1e9)
            self.assertTrue(moved["recording"])
            self.assertGreater(len(moved["laser"]["range_m"]), 60)
            seen += [live, moved]
        # Both clocks are one and the same.
        offset = self.robot(server)["clock_offset"]
        self.assertLessEqual(abs(offset["server_minus_robot_ns"]), offset["uncertainty_ns"])
        self.assertLess(offset["uncertainty_ns"], 1e9)
        link.bytes_per_s = None
        self.assertEqual(agent.wait(timeout=120), 0, agent.stderr.read())
        agent.communicate()
        self.assertIsNone(self.robot(server)["live"])
        self.assertEqual(self.processed(server), frames)
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)
        # Where it was when it was seen, as it turned out.
        path = json.loads(self.ok(server, "soundmap", "robots", "site", "--path", "--robot", "robot", "--format", "json"))["path"]
        for live in seen:
            if live["map_from_base"] is None:
                continue
            nearest = min(path, key=lambda pose: abs(pose["time_ns"] - live["odometry_time_ns"]))
            away_s = abs(nearest["time_ns"] - live["odometry_time_ns"]) * 1e-9
            error_m = math.dist([nearest["x_m"], nearest["y_m"]],
                                [live["map_from_base"]["x_m"], live["map_from_base"]["y_m"]])
            self.assertLess(error_m, 0.3 + away_s)
        # The offset is kept with the session.
        (session,) = self.session_list(server)
        self.assertEqual(len(session["clock_offsets"]), 1)
        server.kill()
        server = self.server("live")
        (session,) = self.session_list(server)
        self.assertEqual(len(session["clock_offsets"]), 1)
        self.assertLessEqual(abs(session["clock_offsets"][0]["server_minus_robot_ns"]),
                             session["clock_offsets"][0]["uncertainty_ns"])
        self.assertEqual(self.robot(server)["clock_offset"], session["clock_offsets"][0])

    def test_a_configuration_with_a_mistake_is_refused(self):
        path = self.config(SHORT, "127.0.0.1:1")
        text = path.read_text()
        for mistake, says in ((text + "max_gigabytes = 1\n", "spool.max_gigabytes"),
                              (text.replace('name = "robot"', ""), "robot.name"),
                              (text.replace("speed = 8", 'speed = "fast"'), "source.speed"),
                              (text + 'when_full = "explode"\n', "spool.when_full"),
                              (text + "max_gb = -1\n", "spool.max_gb"),
                              ("[robot", "agent.toml")):
            path.write_text(mistake)
            self.refused(None, "soundmap-robot", "run", "--config", path, says=says)


if __name__ == "__main__":
    unittest.main()
