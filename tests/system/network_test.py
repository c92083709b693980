"""How frames reach the server over a network: coded, cut, late, half-open."""

import unittest

from programs import DRIVES, ProgramTest

SHORT = DRIVES / "short.mcap"


class NetworkTest(ProgramTest):
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


if __name__ == "__main__":
    unittest.main()
