"""Geometric maps from mapping drives of every kind."""

import json

from programs import DRIVES, ProgramTest

DRIVE = DRIVES / "office.mcap"
MAPPING = DRIVES / "office_mapping.mcap"


class MappingTest(ProgramTest):
    def replay_mapping(self, server, drive, robot="mapper", *, pose_of=None, site="site"):
        arguments = self.replay_arguments(drive, site, robot, pose_of, unknown_start=pose_of is None)
        self.ok(server, "soundmap-robot", *arguments, "--purpose", "mapping")

    def build(self, server, *arguments, site="site"):
        operation = json.loads(self.ok(server, "soundmap", "map", "build", site, *arguments, "--format", "json"))
        report = operation["report"] if "report" in operation else json.loads(operation["report_json"])
        return report

    def pose_error_m(self, server, drive=DRIVE, site="site"):
        self.replay(server, drive, site=site)
        report = json.loads(self.ok(server, "soundmap", "evaluate", site, "--drive", drive, "--format", "json"))
        self.assertEqual(report["pose"]["lost_fraction"], 0)
        return report["pose"]["error_mean_m"]

    def test_an_lrf_and_odometry_make_a_floor_plan(self):
        server = self.server()
        self.ok(server, "soundmap", "site", "create", "site")
        self.replay_mapping(server, DRIVES / "no_lidar.mcap", pose_of=MAPPING)
        self.build(server)
        self.assertLessEqual(self.pose_error_m(server), 0.05)
        plan = self.folder / "plan.yaml"
        self.ok(server, "soundmap", "map", "export", "site", "--what", "floor-plan", "--format", "yaml", "-o", plan)
        self.refused(server, "soundmap", "map", "export", "site", "--what", "geometry", "--format", "bt", "-o",
                     self.folder / "x.bt", says="floor plan")
        # The plan is a map for another site.
        self.ok(server, "soundmap", "site", "create", "copy", "--map", plan)
        self.assertLessEqual(self.pose_error_m(server, site="copy"), 0.05)

    def test_two_drives_merge(self):
        server = self.server()
        self.ok(server, "soundmap", "site", "create", "site")
        self.replay_mapping(server, DRIVES / "until_30.mcap", pose_of=MAPPING)
        self.replay_mapping(server, DRIVES / "from_20.mcap", "second-mapper")
        report = self.build(server)
        self.assertEqual(len(report["sessions"]), 2)
        self.assertLessEqual(self.pose_error_m(server), 0.05)

    def test_a_drive_extends_a_map_and_its_frame_stays(self):
        server = self.server()
        self.ok(server, "soundmap", "site", "create", "site")
        self.replay_mapping(server, DRIVES / "until_30.mcap", pose_of=MAPPING)
        self.build(server)
        self.refused(server, "soundmap", "map", "build", "site", "--extend", says="not in its map yet")
        self.replay_mapping(server, DRIVES / "from_20.mcap", "second-mapper")
        report = self.build(server, "--extend")
        self.assertEqual(len(report["sessions"]), 1)
        self.assertLessEqual(self.pose_error_m(server), 0.05)

    def test_drives_with_an_lrf_alone_merge_and_extend(self):
        server = self.server()
        self.ok(server, "soundmap", "site", "create", "site")
        self.replay_mapping(server, DRIVES / "until_30_no_lidar.mcap", pose_of=MAPPING)
        self.build(server)
        self.replay_mapping(server, DRIVES / "from_20_no_lidar.mcap", "second-mapper")
        report = self.build(server, "--extend")
        self.assertEqual(len(report["sessions"]), 1)
        self.assertLessEqual(self.pose_error_m(server), 0.05)
        report = self.build(server)
        self.assertEqual(len(report["sessions"]), 2)
        self.replay_mapping(server, DRIVES / "mapping_no_lidar.mcap", "lost-mapper")
        self.refused(server, "soundmap", "map", "build", "site", says="does not overlap")
        self.refused(server, "soundmap", "map", "build", "site", "--extend", says="does not overlap")

    def test_a_drive_through_another_building_is_refused(self):
        server = self.server()
        self.ok(server, "soundmap", "site", "create", "site")
        self.replay_mapping(server, MAPPING, pose_of=MAPPING)
        self.build(server)
        before = self.geometry(server)
        self.replay_mapping(server, DRIVES / "mapping.mcap", "lost-mapper")
        self.refused(server, "soundmap", "map", "build", "site", says="does not overlap")
        self.assertEqual(self.geometry(server), before)
        self.assertEqual(len(json.loads(self.ok(server, "soundmap", "sessions", "site", "--format", "json"))["sessions"]), 2)

    def geometry(self, server):
        path = self.folder / "geometry.ot"
        path.unlink(missing_ok=True)
        self.ok(server, "soundmap", "map", "export", "site", "--what", "geometry", "--format", "ot", "-o", path)
        return path.read_bytes()
