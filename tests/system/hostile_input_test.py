"""Bad input is normal input: one clear sentence or the stated behaviour, the right exit status, the server alive, the map unharmed."""

import json
import os
import random
import shutil
import socket
import subprocess
import unittest

from programs import BIN, DRIVES, ProgramTest, run

SHORT = DRIVES / "short.mcap"


class HostileInputTest(ProgramTest):
    def setUp(self):
        super().setUp()
        self.running = self.server()
        self.make_site(self.running)
        self.replay(self.running, SHORT)
        self.voxels = self.full_map(self.running)

    def unharmed(self):
        self.assertTrue(self.running.alive())
        self.assertEqual(self.full_map(self.running), self.voxels)

    def damaged(self, name, change):
        path = self.folder / name
        data = bytearray(SHORT.read_bytes())
        change(data)
        path.write_bytes(data)
        shutil.copy(DRIVES / "short.truth.json", path.with_suffix(".truth.json"))
        return path

    def replay_to(self, site, drive, **expected):
        arguments = self.replay_arguments(drive, site=site, robot="other", pose_of=SHORT)
        return self.refused(self.running, "soundmap-robot", *arguments, **expected)

    def other_site(self):
        self.ok(self.running, "soundmap", "site", "create", "other", "--map", self.geometry())
        return "other"

    def geometry(self):
        path = self.folder / "geometry.bt"
        self.ok(self.running, "soundmap", "map", "export", "site", "--what", "geometry", "--format", "bt", "-o", path)
        return path

    def test_truncated_recording(self):
        def cut(data):
            del data[len(data) * 2 // 3:]

        self.replay_to(self.other_site(), self.damaged("cut.mcap", cut), says="cut.mcap")
        self.unharmed()

    def test_bit_flips(self):
        site = self.other_site()
        generator = random.Random(7)
        for i in range(3):
            def flip(data):
                data[generator.randrange(len(data) // 4, len(data) * 3 // 4)] ^= 1 << generator.randrange(8)

            self.replay_to(site, self.damaged(f"flip{i}.mcap", flip), says=f"flip{i}.mcap")
        self.unharmed()

    def test_not_a_recording(self):
        path = self.folder / "noise.mcap"
        path.write_bytes(random.Random(1).randbytes(10_000))
        self.replay_to("site", path, says="noise.mcap")
        path.write_bytes(b"")
        self.replay_to("site", path, says="noise.mcap")
        self.replay_to("site", self.folder / "missing.mcap", says="missing.mcap")
        self.unharmed()

    def test_a_drive_without_audio_is_localized_and_says_so(self):
        site = self.other_site()
        self.replay(self.running, DRIVES / "no_audio.mcap", site=site, pose_of=SHORT)
        self.assertIn("/audio", self.ok(self.running, "soundmap", "sessions", site, "--format", "json"))
        path = self.ok(self.running, "soundmap", "robots", site, "--path", "--format", "csv")
        self.assertGreater(len(path.splitlines()), 10)
        self.assertNotIn("position", self.sources_json(self.running, site))

    def test_missing_microphones(self):
        for count in (0, 3):
            with self.subTest(microphones=count):
                self.replay_to("site", DRIVES / f"microphones_{count}.mcap", says="mic_")
        self.unharmed()

    def test_sensors_that_see_nothing(self):
        site = self.other_site()
        empty = self.full_map(self.running, site)
        for drive in ("nan_ranges", "invalid_lidar"):
            with self.subTest(drive):
                self.replay(self.running, DRIVES / f"{drive}.mcap", site=site, robot=drive.replace("_", "-"), pose_of=SHORT)
                self.assertEqual(self.full_map(self.running, site), empty)
        self.unharmed()

    def test_a_dead_microphone_is_done_without_and_told(self):
        site = self.other_site()
        self.replay(self.running, DRIVES / "dead_microphone.mcap", site=site, pose_of=SHORT)
        self.assertIn("without a dead microphone", self.ok(self.running, "soundmap", "sessions", site, "--format", "json"))
        self.assertNotEqual(json.loads(self.sources_json(self.running, site))["sources"], [])

    def test_time_running_backwards(self):
        site = self.other_site()
        self.replay(self.running, DRIVES / "backwards.mcap", site=site, pose_of=SHORT)
        self.assertIn("backwards", self.ok(self.running, "soundmap", "sessions", site, "--format", "json"))
        self.unharmed()

    def test_other_rates_and_drifting_clocks_are_no_faults(self):
        for drive in ("fast_audio", "drifting_clock"):
            with self.subTest(drive):
                site = drive.replace("_", "-")
                self.ok(self.running, "soundmap", "site", "create", site, "--map", self.geometry())
                self.replay(self.running, DRIVES / f"{drive}.mcap", site=site)
                self.assertIn("position", self.sources_json(self.running, site))

    def test_a_site_that_does_not_exist(self):
        self.replay_to("nowhere", SHORT, says="nowhere")
        self.refused(self.running, "soundmap", "sources", "nowhere", says="nowhere")
        self.refused(self.running, "soundmap", "map", "build", "nowhere", says="nowhere")

    def test_names_that_are_none(self):
        for name in ("..", "a/b", "UPPER", "x" * 64, "-x", "a b"):
            with self.subTest(name):
                result = run(self.running, "soundmap", "site", "create", "--", name)
                self.assertIn(result.returncode, (1, 2))
                self.assertEqual(len(result.stderr.strip().splitlines()), 1, result.stderr)

    def test_a_name_that_is_no_text_is_refused_and_fills_no_log(self):
        environment = dict(os.environ, SOUNDMAP_SERVER=self.running.address)
        result = subprocess.run([BIN / "soundmap", "sources", b"\xff\xfe"], env=environment, capture_output=True, timeout=60)
        self.assertEqual(result.returncode, 1, result.stderr)
        self.assertEqual(len(result.stderr.strip().splitlines()), 1, result.stderr)
        self.assertNotIn("protobuf", self.running.log_path.read_text())

    def test_a_site_without_a_map(self):
        self.ok(self.running, "soundmap", "site", "create", "bare")
        self.replay_to("bare", SHORT, says="no geometric map")
        self.refused(self.running, "soundmap", "map", "build", "bare", says="no mapping drive")

    def test_a_busy_port(self):
        listener = socket.create_server(("127.0.0.1", 0))
        self.addCleanup(listener.close)
        port = listener.getsockname()[1]
        for flag in ("--grpc", "--http"):
            free = "--http" if flag == "--grpc" else "--grpc"
            result = subprocess.run([BIN / "soundmap-server", "--data-dir", self.folder / "busy", flag, f"127.0.0.1:{port}",
                                     free, "127.0.0.1:0", "--log-level", "off"], capture_output=True, text=True, timeout=60)
            self.assertEqual(result.returncode, 1)
            self.assertIn(str(port), result.stderr)

    def test_a_folder_in_use_or_not_writable(self):
        result = subprocess.run([BIN / "soundmap-server", "--data-dir", self.folder / "data", "--grpc", "127.0.0.1:0", "--http",
                                 "127.0.0.1:0", "--log-level", "off"], capture_output=True, text=True, timeout=60)
        self.assertEqual(result.returncode, 1)
        self.assertIn("in use", result.stderr)
        result = subprocess.run([BIN / "soundmap-server", "--data-dir", "/proc/nowhere", "--log-level", "off"],
                                capture_output=True, text=True, timeout=60)
        self.assertEqual(result.returncode, 1)
        self.assertIn("/proc/nowhere", result.stderr)

    def test_a_full_disk(self):
        # A file system of its own, filled up to little more than the 64 MiB that the server keeps free.
        disk = self.folder / "disk"
        disk.mkdir()
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300m", "none", disk], capture_output=True).returncode != 0:
            self.skipTest("a small file system cannot be mounted without privileges")
        self.addCleanup(subprocess.run, ["umount", "-l", disk])
        server = self.server("disk/data")
        self.ok(server, "soundmap", "site", "create", "site", "--map", self.geometry())
        filler = disk / "filler"
        free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
        filler.write_bytes(bytes(free - (72 << 20)))
        result = run(server, "soundmap-robot", *self.replay_arguments(DRIVES / "drive.mcap"), "--connect-timeout", "3")
        self.assertEqual(result.returncode, 1, result.stdout + result.stderr)
        self.assertIn("disk", result.stderr)
        self.assertTrue(server.alive())
        self.sources_json(server)  # questions go on
        # With space again the drive goes on where it was.
        filler.unlink()
        self.replay(server, DRIVES / "drive.mcap")
        self.assertIn("position", self.sources_json(server))
        server.kill()


if __name__ == "__main__":
    unittest.main()
