"""What is durable survives the end of the server, however it comes."""

import json
import re
import subprocess
import unittest
import urllib.request

from programs import BIN, DRIVES, ProgramTest, start, start_pose

DRIVE = DRIVES / "drive.mcap"


class DurabilityTest(ProgramTest):
    def test_a_restarted_server_answers_the_same(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVE)
        sources, voxels = self.source_history_json(server), self.full_map(server)
        self.assertEqual(server.stop(), 0)
        server = self.server()
        self.assertEqual(self.source_history_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)
        # And after a crash, from the journal.
        server.kill()
        server = self.server()
        self.assertEqual(self.source_history_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)

    def test_the_same_drive_again_counts_nothing(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVES / "short.mcap")
        sources, voxels = self.source_history_json(server), self.full_map(server)
        self.replay(server, DRIVES / "short.mcap")
        self.assertEqual(self.source_history_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)
        # Asked to, it counts again.
        self.ok(server, "soundmap-robot", *self.replay_arguments(DRIVES / "short.mcap"), "--new-session")
        self.assertNotEqual(self.full_map(server), voxels)

    def test_kill_at_random_moments_of_a_drive(self):
        server = self.server("undisturbed")
        self.make_site(server)
        self.replay(server, DRIVE)
        sources, voxels = self.source_history_json(server), self.full_map(server)
        frames = self.processed(server)
        server.kill()

        server = self.server("killed")
        self.make_site(server)
        server = self.replay_while_killing(server, frames, self.replay_arguments(DRIVE, speed="8"))
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.source_history_json(server), sources)

    def test_a_restart_computes_little_again_however_long_the_drive(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVE, robot="whole")
        (whole,) = self.session_list(server)
        frames_per_s = whole["processed"] / (whole["last_frame_time_ns"] - whole["first_frame_time_ns"]) * 1e9
        robot = start(server, "soundmap-robot", *self.replay_arguments(DRIVE, robot="cut"), "--connect-timeout", "1")

        def cut():
            return next((session for session in self.session_list(server) if session["robot"].endswith("cut")), {"processed": 0})

        while cut()["processed"] < 0.7 * whole["processed"] and robot.poll() is None:
            pass
        server.kill()
        robot.terminate()
        robot.communicate()
        server = self.server()
        with urllib.request.urlopen(f"http://{server.http_address}/metrics") as answer:
            replayed = int(re.search(r"^soundmap_replayed_frames_total (\d+)", answer.read().decode(), re.M).group(1))
        # The state of the pipeline is kept every 10 s of driving, when a batch of up to 64 frames ends.
        self.assertLessEqual(replayed, 10 * frames_per_s + 2 * 64)
        self.assertGreater(replayed, 0)
        # What was durable and had no effect yet has it now, without the robot.
        while cut()["processed"] < cut()["durable"]:
            self.assertTrue(server.alive())
        self.assertGreaterEqual(cut()["processed"], 0.7 * whole["processed"])

    def test_frames_that_are_kept_no_longer_leave_the_map_as_it_is(self):
        server = self.server()
        self.make_site(server)
        self.ok(server, "soundmap", "site", "set", "site", "--keep-frames", "1s")
        self.replay(server, DRIVES / "short.mcap")
        sources, voxels = self.source_history_json(server), self.full_map(server)
        (drive,) = self.session_list(server)
        logs = server.data_dir / "sessions" / "site"
        self.assertEqual(len(list(logs.iterdir())), 2)
        while not self.session_list(server)[0]["frames_dropped"]:
            self.assertTrue(server.alive())
        # The mapping drive stays: the map may be made again.
        self.assertNotIn(logs / drive["id"], list(logs.iterdir()))
        self.assertEqual(len(list(logs.iterdir())), 1)
        self.refused(server, "soundmap", "tune", "--case", "site", DRIVES / "short.truth.json", DRIVES / "short.mcap", says="kept")
        # Sent again, it is known.
        self.replay(server, DRIVES / "short.mcap")
        self.assertEqual(server.stop(), 0)
        self.assertIn("no fault", self.ok(None, "soundmap-server", "--check", "--data-dir", server.data_dir))
        server = self.server()
        self.assertEqual(self.source_history_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)

    def test_sigterm_under_load(self):
        """Robots at full speed, idle sessions and watchers: exits in time, and what it said to be durable is there."""
        server = self.server("data", "--max-calls-per-s", "10000")
        self.make_site(server)
        crowd = start(server, "crowd", server.address, "site", "300", "50")
        self.addCleanup(crowd.kill)
        fleet = subprocess.Popen([BIN / "fleet", server.address, "site", DRIVE, start_pose(DRIVE), "4"],
                                 stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.addCleanup(fleet.kill)
        fleet.stdout.readline()
        robots = [start(server, "soundmap-robot", *self.replay_arguments(DRIVE, robot=f"r{i}"), "--connect-timeout", "20") for i in range(4)]
        while self.processed(server) < 400:
            self.assertTrue(any(robot.poll() is None for robot in robots))
        durable = {session["id"]: session["durable"] for session in self.session_list(server)}
        self.assertEqual(server.stop(within_s=10), 0)
        said = json.loads(fleet.communicate()[0])
        self.assertEqual(said["ended_early"], 4)
        self.assertTrue(said["warned_first"], "who watches the server's health hears of its end before the robots feel it")
        for robot in robots:
            robot.terminate()
            robot.communicate()
        server = self.server()
        received = {session["id"]: session["received"] for session in self.session_list(server)}
        self.assertEqual([name for name in durable if received[name] < durable[name]], [])
        for i in range(4):
            self.replay(server, DRIVE, robot=f"r{i}")
        driven = [session for session in self.session_list(server) if session["robot"].split("/")[-1].startswith("r")]
        self.assertEqual(len({session["processed"] for session in driven}), 1, "each drove the same drive")

    def test_sigterm_in_the_middle_of_a_drive(self):
        server = self.server("undisturbed")
        self.make_site(server)
        self.replay(server, DRIVE)
        voxels = self.full_map(server)
        server.kill()

        server = self.server("stopped")
        self.make_site(server)
        robot = start(server, "soundmap-robot", *self.replay_arguments(DRIVE), "--connect-timeout", "1")
        while self.processed(server) < 100 and robot.poll() is None:
            pass
        self.assertEqual(server.stop(within_s=10), 0)
        robot.terminate()
        robot.communicate()
        server = self.server("stopped")
        self.replay(server, DRIVE)
        self.assertEqual(self.full_map(server), voxels)


if __name__ == "__main__":
    unittest.main()
