"""What is durable survives the end of the server, however it comes."""

import unittest

from programs import DRIVES, ProgramTest, run, start

DRIVE = DRIVES / "drive.mcap"


class DurabilityTest(ProgramTest):
    def test_a_restarted_server_answers_the_same(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVE)
        sources, voxels = self.sources_json(server), self.full_map(server)
        self.assertEqual(server.stop(), 0)
        server = self.server()
        self.assertEqual(self.sources_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)
        # And after a crash, from the journal.
        server.kill()
        server = self.server()
        self.assertEqual(self.sources_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)

    def test_the_same_drive_again_counts_nothing(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVES / "short.mcap")
        sources, voxels = self.sources_json(server), self.full_map(server)
        self.replay(server, DRIVES / "short.mcap")
        self.assertEqual(self.sources_json(server), sources)
        self.assertEqual(self.full_map(server), voxels)
        # Asked to, it counts again.
        self.ok(server, "soundmap-robot", *self.replay_arguments(DRIVES / "short.mcap"), "--new-session")
        self.assertNotEqual(self.full_map(server), voxels)

    def processed(self, server):
        sessions = self.sessions(server)
        sessions = sessions["sessions"] if isinstance(sessions, dict) else sessions
        return sum(int(s["processed"]) for s in sessions if not s["robot"].endswith("mapper"))

    def test_kill_at_five_moments_of_a_drive(self):
        server = self.server("undisturbed")
        self.make_site(server)
        self.replay(server, DRIVE)
        sources, voxels = self.sources_json(server), self.full_map(server)
        frames = self.processed(server)
        server.kill()

        server = self.server("killed")
        self.make_site(server)
        interrupted = 0
        for moment in range(1, 6):
            # At a pace, so that the frames do not run ahead of what is processed.
            robot = start(server, "soundmap-robot", *self.replay_arguments(DRIVE, speed="8"), "--connect-timeout", "5")
            while self.processed(server) < frames * moment / 8 and robot.poll() is None:
                pass
            interrupted += robot.poll() is None
            server.kill()
            robot.terminate()
            robot.communicate()
            server = self.server("killed")
        self.assertGreaterEqual(interrupted, 3)
        self.replay(server, DRIVE)
        self.assertEqual(self.processed(server), frames)
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)

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
        self.assertEqual(server.stop(), 0)
        robot.terminate()
        robot.communicate()
        server = self.server("stopped")
        self.replay(server, DRIVE)
        self.assertEqual(self.full_map(server), voxels)


if __name__ == "__main__":
    unittest.main()
