"""What a user sees of sources that move, of several robots and of people, through the real programs."""

import json
import math
import unittest

from programs import DRIVES, ProgramTest, start


class SourcesTest(ProgramTest):
    def found(self, server, site="site"):
        """Those that are announced."""
        listed = json.loads(self.ok(server, "soundmap", "sources", site, "--min-probability", "0.5", "--format", "json"))
        return listed["sources"]

    def at(self, sources, true):
        """The only one near a true place."""
        near = [source for source in sources if math.dist(source["position_m"], true["position"]) < 0.5]
        self.assertEqual(len(near), 1, (true["position"], sources))
        return near[0]

    def truth(self, name):
        return json.loads((DRIVES / f"{name}.truth.json").read_text())["sources"]

    def test_a_source_that_moved_keeps_its_name(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVES / "pair.mcap")
        stays, moves = self.truth("pair")
        before = self.found(server)
        self.assertEqual(len(before), 2)
        watch = start(server, "soundmap", "watch", "site", "--sources")
        self.addCleanup(watch.communicate)
        self.addCleanup(watch.terminate)
        self.replay(server, DRIVES / "pair_moved.mcap")
        after = self.found(server)
        _, moved = self.truth("pair_moved")
        self.assertEqual(math.dist(moves["position"], moved["position"]), 3)
        self.assertEqual(self.at(after, stays)["id"], self.at(before, stays)["id"])
        self.assertEqual(self.at(after, moved)["id"], self.at(before, moves)["id"])
        left = [source for source in after if math.dist(source["position_m"], moves["position"]) < 1]
        self.assertEqual(left, [], "nothing is left behind")
        for line in watch.stdout:
            event = json.loads(line)
            if event["event"] == "source_moved":
                break
        self.assertEqual(event["sound_source"]["id"], self.at(before, moves)["id"])
        self.assertLess(math.dist(event["from_m"], moves["position"]), 0.5)

    def test_calibrated_microphones_give_sound_pressure_levels(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVES / "pair.mcap")
        self.assertEqual([source for source in self.found(server) if "spl_db" in source], [])
        # What 0 dB is, a square wave of full scale, is 3 dB more than a sine of full scale.
        zero_db = 120 + 10 * math.log10(2)
        calibrated = self.replay_arguments(DRIVES / "pair.mcap", robot="calibrated")
        self.ok(server, "soundmap-robot", *calibrated, "--full-scale-spl", "120")
        self.assertEqual(len(self.found(server)), 2)
        for source in self.found(server):  # both robots heard the same, the first one not before it was a source
            self.assertAlmostEqual(source["spl_db"], source["level_db"] + zero_db, delta=0.3)
            for octave in source["spectrum"]:
                self.assertAlmostEqual(octave["spl_db"], octave["level_db"] + zero_db, delta=1)
        self.refused(server, "soundmap-robot", *calibrated, "--full-scale-spl", "-26", status=2, says="--full-scale-spl")

    def test_several_robots_find_what_one_finds(self):
        server = self.server()
        for site in ("one", "turns", "together"):
            self.make_site(server, site)
        drives = [DRIVES / "pair.mcap", DRIVES / "pair_again.mcap"]
        for drive in drives:
            self.replay(server, drive, site="one")
            self.replay(server, drive, site="turns", robot=drive.stem)
        robots = [start(server, "soundmap-robot", *self.replay_arguments(drive, "together", robot=drive.stem)) for drive in drives]
        for robot in robots:
            _, said = robot.communicate()
            self.assertEqual(robot.returncode, 0, said)
        of_one = self.found(server, "one")
        self.assertEqual(len(of_one), 2)
        for site in ("turns", "together"):
            found = self.found(server, site)
            self.assertEqual(len(found), 2, site)
            for true in self.truth("pair"):
                self.assertLessEqual(math.dist(self.at(found, true)["position_m"], self.at(of_one, true)["position_m"]), 0.03)
                self.assertEqual(sorted(self.at(found, true)["robots"]), ["pair", "pair_again"])

    def test_people_who_walk_by_are_no_sources(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVES / "people.mcap")
        self.assertEqual(self.found(server), [])
        self.make_site(server, "busy")
        self.replay(server, DRIVES / "pair_people.mcap", site="busy")
        found = self.found(server, "busy")
        self.assertEqual(len(found), 2)
        for true in self.truth("pair_people"):
            self.at(found, true)


if __name__ == "__main__":
    unittest.main()
