"""How frames reach the server over a network that fails: coded, spooled, cut, with the agent killed."""

import ctypes
import json
import math
import os
import queue
import shutil
import socket
import subprocess
import sys
import threading
import time
import unittest
import urllib.request

from programs import BIN, DRIVES, SOURCE, ProgramTest, random_moments, start, start_pose

SHORT = DRIVES / "short.mcap"
# Drives that the link is cut for are as long as is asked for, and so is the wait for what they give.
CUT_MINUTES = float(os.environ.get("SOUNDMAP_CUT_MINUTES", 0))
TIMEOUT_S = 300 + 60 * CUT_MINUTES


class Link:
    """A TCP proxy to the server. While it is down, nobody gets through and no connection lives; while it is stalled, connections live and
    nothing gets through. What it carries arrives `delay_s` later, and no faster than `bytes_per_s` in each direction of a connection."""

    def __init__(self, up=True, delay_s=0.0, bytes_per_s=None):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        self.target = None
        self.is_up = up
        self.delay_s = delay_s
        self.bytes_per_s = bytes_per_s
        self.flows = threading.Event()
        self.flows.set()
        self.lock = threading.Lock()
        self.connections = []  # (client, server, flowing)
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
                flowing = threading.Event()
                flowing.set()
                self.connections.append((client, server, flowing))
            for source, sink in ((client, server), (server, client)):
                under_way = queue.Queue()
                threading.Thread(target=self.take, args=(source, under_way), daemon=True).start()
                threading.Thread(target=self.deliver, args=(under_way, source, sink, flowing), daemon=True).start()

    def take(self, source, under_way):
        try:
            while data := source.recv(1 << 16):
                under_way.put((time.monotonic() + self.delay_s, data))
        except OSError:
            pass
        under_way.put((0.0, b""))

    def deliver(self, under_way, source, sink, flowing):
        try:
            while True:
                due, data = under_way.get()
                time.sleep(max(0.0, due - time.monotonic()))
                flowing.wait()
                self.flows.wait()
                if not data:
                    break
                sink.sendall(data)
                if self.bytes_per_s:
                    time.sleep(len(data) / self.bytes_per_s)
        except OSError:
            pass
        self.end(source, sink)
        with self.lock:
            others = [connection for connection in self.connections if source not in connection]
            if len(others) == len(self.connections):  # the other direction has ended before
                source.close()
                sink.close()
            self.connections = others

    @staticmethod
    def end(*ends):
        for end in ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def freeze(self):
        """The connections there are carry nothing more, and nobody is told; new ones work."""
        with self.lock:
            for _, _, flowing in self.connections:
                flowing.clear()

    def down(self):
        with self.lock:
            self.is_up = False
            for client, server, flowing in self.connections:
                self.end(client, server)
                flowing.set()
            self.connections = []

    def up(self):
        with self.lock:
            self.is_up = True

    def close(self):
        self.listener.close()
        self.down()


class NetworkTest(ProgramTest):
    def link_to(self, server, up=True, **carries):
        link = Link(up, **carries)
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
        self.assertEqual(agent.wait(timeout=TIMEOUT_S), 0, agent.stderr.read())
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

    def finish_like(self, undisturbed, server, agent):
        """The agent delivers all, and the map is the undisturbed one."""
        self.assertEqual(agent.wait(timeout=TIMEOUT_S), 0, agent.stderr.read())
        agent.communicate()
        self.assertEqual((self.sources_json(server), self.full_map(server), self.processed(server)), undisturbed)

    def afresh(self, name):
        """A server with the site, and no spool."""
        shutil.rmtree(self.folder / "spool", ignore_errors=True)
        server = self.server(name)
        self.make_site(server)
        return server

    def test_slow_and_silent_links_lose_nothing(self):
        undisturbed = self.undisturbed(SHORT)
        frames = undisturbed[2]

        with self.subTest("half a second away, 1 MB/s"):
            server = self.afresh("slow")
            link = self.link_to(server, delay_s=0.5, bytes_per_s=1e6)
            agent = start(server, "soundmap-robot", "run", "--config", self.config(SHORT, link.address, speed=0))
            self.finish_like(undisturbed, server, agent)
            server.kill()

        with self.subTest("a peer that vanishes without a word"):
            server = self.afresh("silent")
            link = self.link_to(server)
            agent = start(server, "soundmap-robot", "run", "--config", self.config(SHORT, link.address, speed=1))
            while self.processed(server) < 0.2 * frames:
                self.assertIsNone(agent.poll())
            link.freeze()
            stopped_at = self.processed(server)
            self.finish_like(undisturbed, server, agent)
            self.assertLess(stopped_at, frames)
            server.kill()

    def test_a_link_that_is_cut_for_most_of_a_drive(self):
        drive, at_speed = SHORT, 4
        if CUT_MINUTES:
            # As fast as the disk takes it: what the robot drives meanwhile lies in its spool.
            drive, at_speed = self.folder / "long.mcap", 0
            scene = json.loads((SOURCE / "robot-agent/sources/simulation/scenes/grill_room.json").read_text())
            scene["path"]["laps"] = math.ceil(60 * CUT_MINUTES / 29)  # of 29.4 s
            scene_file = self.folder / "long.json"
            scene_file.write_text(json.dumps(scene))
            subprocess.run([BIN / "soundmap-robot", "simulate", scene_file, "--seconds", str(60 * CUT_MINUTES), "--out", drive],
                           check=True, stdout=subprocess.DEVNULL)
        undisturbed = self.undisturbed(drive)
        frames = undisturbed[2]
        server = self.afresh("cut")
        link = self.link_to(server)
        agent = start(server, "soundmap-robot", "run", "--config", self.config(drive, link.address, speed=at_speed))
        while self.processed(server) < min(1000, 0.1 * frames):
            self.assertIsNone(agent.poll())
        link.down()
        while not any(session["ended"] for session in self.spooled()):
            self.assertIsNone(agent.poll())
        (session,) = self.spooled()
        link.up()
        back = time.monotonic()
        while self.durable(server) < session["recorded"] and agent.poll() is None:
            pass
        drained_s = time.monotonic() - back
        self.finish_like(undisturbed, server, agent)
        in_map_s = time.monotonic() - back
        (result,) = self.session_list(server)
        backlog_s = session["waiting"] / frames * (result["last_frame_time_ns"] - result["first_frame_time_ns"]) * 1e-9
        print(f"a backlog of {backlog_s:.1f} s was durable after {drained_s:.1f} s and in the map after {in_map_s:.1f} s", file=sys.stderr)
        if CUT_MINUTES:
            self.assertGreater(backlog_s, 0.9 * 60 * CUT_MINUTES)
            self.assertLess(4 * in_map_s, backlog_s)

    def test_a_link_that_loses_every_fifth_packet(self):
        libc = ctypes.CDLL(None, use_errno=True)
        new_network = 0x40000000  # CLONE_NEWNET, of <sched.h>
        home = os.open("/proc/self/ns/net", os.O_RDONLY)
        self.addCleanup(os.close, home)
        if libc.unshare(new_network) != 0:
            self.skipTest(f"a network of its own is not allowed here: {os.strerror(ctypes.get_errno())}")
        self.addCleanup(libc.setns, home, new_network)
        subprocess.run(["ip", "link", "set", "lo", "up"], check=True)

        def loss(change):
            return subprocess.run(["tc", "qdisc", change, "dev", "lo", "root", "netem", "loss", "20%"], capture_output=True, text=True)

        offered = loss("add")
        if offered.returncode != 0:
            self.skipTest(f"this kernel loses no packets on demand: {offered.stderr.strip()}")
        loss("del")
        undisturbed = self.undisturbed(SHORT)
        server = self.afresh("lossy")
        self.assertEqual(loss("add").returncode, 0)
        agent = start(server, "soundmap-robot", "run", "--config", self.config(SHORT, server.address))
        self.finish_like(undisturbed, server, agent)

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
            # The odometry has carried on since the newest localized frame, longer on a busy machine: 1 % too far, turned by 0.0095 rad a metre.
            carried_m = 0.6 * (live["odometry_time_ns"] - live["localized_time_ns"]) * 1e-9
            self.assertLess(error_m, 0.2 + away_s + 0.01 * carried_m + 0.5 * 0.0095 * carried_m**2)
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
