"""A robot that does not know where it is hears all the same; the map gets it once the robot knows."""

import json

from programs import DRIVES, ProgramTest

DRIVE = DRIVES / "office.mcap"
KIDNAPPED = DRIVES / "kidnapped_12_19.mcap"


class LocalizationTest(ProgramTest):
    def office(self, name="data"):
        server = self.server(name)
        self.make_site(server, mapping=DRIVES / "office_mapping.mcap")
        return server

    def evaluate(self, server, drive):
        return json.loads(self.ok(server, "soundmap", "evaluate", "site", "--truth", DRIVES / "office.truth.json",
                                  "--drive", drive, "--format", "json"))

    def audio_scans(self, server):
        return sum(int(session["audio_scans"]) for session in self.session_list(server))

    def test_a_robot_with_an_unknown_start_loses_nothing(self):
        server = self.office("known")
        self.replay(server, DRIVE)
        known, known_scans = self.evaluate(server, DRIVE), self.audio_scans(server)

        server = self.office("unknown")
        self.replay(server, DRIVE, unknown_start=True)
        report = self.evaluate(server, DRIVE)
        self.assertLessEqual(report["pose"]["error_mean_m"], 0.05)
        self.assertLessEqual(report["pose"]["lost_fraction"], 0.02)
        self.assertEqual(report["sources"]["detected"], known["sources"]["detected"])
        self.assertEqual(report["sources"]["false"], known["sources"]["false"])
        self.assertGreaterEqual(self.audio_scans(server), 0.97 * known_scans)

    def test_a_kidnapped_robot_recovers_and_writes_nothing_wrong(self):
        server = self.office()
        self.replay(server, KIDNAPPED, pose_of=DRIVE)
        report = self.evaluate(server, KIDNAPPED)
        self.assertLessEqual(report["pose"]["error_mean_m"], 0.05)
        self.assertLessEqual(report["pose"]["error_p95_m"], 0.10)
        self.assertLessEqual(report["pose"]["lost_fraction"], 0.10)
        self.assertEqual(report["sources"]["false"], 0)

    def test_crashes_while_the_robot_is_lost_change_nothing(self):
        server = self.office("undisturbed")
        self.replay(server, KIDNAPPED, unknown_start=True)
        sources, voxels = self.sources_json(server), self.full_map(server)
        frames = self.processed(server)
        server.kill()
        server = self.replay_while_killing(
            self.office("killed"), frames, self.replay_arguments(KIDNAPPED, speed="8", unknown_start=True))
        self.assertEqual(self.full_map(server), voxels)
        self.assertEqual(self.sources_json(server), sources)
