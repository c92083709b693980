"""Maps by frequency band of one drive, through the real programs."""

import json
import math
import subprocess
import unittest

from programs import BIN, DRIVES, ProgramTest, start

BANDS = ("hiss=4500-7500", "low=1000-2800", "bats=20000-40000")
NAMES = ("", "hiss", "low", "bats")


class BandsTest(ProgramTest):
    def found(self, server, band, site="site"):
        """Those that are announced."""
        listed = self.ok(server, "soundmap", "sources", site, "--band", band, "--min-probability", "0.5", "--format", "json")
        return json.loads(listed)["sources"]

    def near(self, sources, true):
        return [source for source in sources if math.dist(source["position_m"], true["position"]) < 0.5]

    def everything(self, server, site="site"):
        """All that is told of each band, as bytes."""
        return {band: (self.full_map(server, site, band), self.source_history_json(server, site, band)) for band in NAMES}

    def test_each_band_has_the_sources_of_its_frequencies(self):
        server = self.server()
        self.make_site(server, bands=BANDS)
        # Of the same name, of which the session's name comes, and of that the path.
        plain = self.server("plain")
        self.make_site(plain)
        watch = start(server, "soundmap", "watch", "site", "--sources", "--scans", "--band", "hiss")
        self.addCleanup(watch.communicate)
        self.addCleanup(watch.terminate)
        while json.loads(watch.stdout.readline())["event"] != "snapshot_complete":
            pass
        for each in (server, plain):
            self.replay(each, DRIVES / "two_pitches.mcap")
        hiss, low = json.loads((DRIVES / "two_pitches.truth.json").read_text())["sources"]
        for band, there, elsewhere in (("hiss", hiss, low), ("low", low, hiss)):
            sources = self.found(server, band)
            self.assertEqual(len(self.near(sources, there)), 1, sources)
            self.assertEqual(self.near(sources, elsewhere), [], sources)
            for source in sources:
                self.assertEqual(source["band"], band)
                self.assertTrue(source["id"].startswith(f"{band}-"))
        self.assertEqual(self.found(server, "bats"), [])
        # The main map is that of a site without bands.
        self.assertEqual(self.full_map(server), self.full_map(plain))
        sources = [json.loads(self.source_history_json(each))["sources"] for each in (server, plain)]
        self.assertEqual(*sources)
        self.assertNotIn("band", json.dumps(sources))
        for each, said in ((server, 1), (plain, 0)):
            warnings = self.session_list(each)[0]["warnings"]
            self.assertEqual(len([warning for warning in warnings if "'bats'" in warning]), said, warnings)
        # Who watched was told of the one band.
        while True:
            event = json.loads(watch.stdout.readline())
            if event["event"] == "audio_scan":
                self.assertEqual(event["band"], "hiss")
            elif event["event"] == "sound_source_removed":
                self.assertTrue(event["id"].startswith("hiss-"), event)
            else:
                self.assertEqual(event["sound_source"]["band"], "hiss")
            if event["event"] == "source_appeared":
                break
        for command in (("sources",), ("voxels", "--box=0,0,0,1,1,1"), ("watch",),
                        ("map", "export", "--what=sound", "--format=png", "-o", self.folder / "no.png")):
            self.refused(server, "soundmap", *command, "site", "--band", "hum", says="it has hiss, low, bats")
        self.assertIn("band hiss: 4500 to 7500 Hz", self.ok(server, "soundmap", "site", "show", "site"))
        self.refused(server, "soundmap", "site", "create", "other", "--band", "back=500-100", says="'back'")

    def test_all_bands_are_the_same_after_crashes(self):
        server = self.server()
        self.make_site(server, bands=BANDS)
        whole = self.server("whole")
        self.make_site(whole, bands=BANDS)
        self.replay(whole, DRIVES / "two_pitches.mcap")
        undisturbed = self.everything(whole)
        self.assertEqual(len({voxels for voxels, _ in undisturbed.values()}), 4)
        frames = self.processed(whole)

        server = self.replay_while_killing(server, frames,
                                           self.replay_arguments(DRIVES / "two_pitches.mcap", speed="8"))
        self.assertEqual(self.everything(server), undisturbed)
        server.kill()
        server = self.server(server.data_dir.name)
        self.assertEqual(self.everything(server), undisturbed)
        # And from a checkpoint.
        self.assertEqual(server.stop(), 0)
        checked = subprocess.run([BIN / "soundmap-server", "--check", "--data-dir", server.data_dir], capture_output=True, text=True)
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        self.assertEqual(self.everything(self.server(server.data_dir.name)), undisturbed)


if __name__ == "__main__":
    unittest.main()
