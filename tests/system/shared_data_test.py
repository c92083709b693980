"""The sample drives with truth, where they are at hand (SOUNDMAP_DATA, or shared/data beside the source tree)."""

import json
import os
import pathlib
import unittest

from programs import SOURCE, ProgramTest

DATA = pathlib.Path(os.environ.get("SOUNDMAP_DATA") or SOURCE.parent / "shared/data")


@unittest.skipUnless((DATA / "grill_room").is_dir(), f"no sample data at {DATA}")
class SharedDataTest(ProgramTest):
    def test_grill_room(self):
        room = DATA / "grill_room"
        server = self.server()
        self.make_site(server, mapping=room / "mapping.mcap")
        self.replay(server, room / "drive.mcap")
        report = json.loads(self.ok(server, "soundmap", "evaluate", "site", "--truth", room / "drive.truth.json", "--drive",
                                    room / "drive.mcap", "--format", "json"))
        print(json.dumps(report))
        sources, pose = report["sources"], report["pose"]
        self.assertEqual((sources["detected"], sources["false"], sources["double"]), (6, 0, 0))
        self.assertLessEqual(sources["error_mean_m"], 0.08)
        self.assertLessEqual(pose["error_mean_m"], 0.05)
        self.assertLessEqual(pose["error_p95_m"], 0.10)
        self.assertEqual(pose["lost_fraction"], 0)


if __name__ == "__main__":
    unittest.main()
