"""A copy of a running server, the way back, and the check of what is stored."""

import subprocess
import unittest

from programs import BIN, DRIVES, ProgramTest, start

DRIVE = DRIVES / "short.mcap"


class BackupTest(ProgramTest):
    def tool(self, *arguments, status=0):
        result = subprocess.run([BIN / "soundmap-server", *map(str, arguments)], capture_output=True, text=True, timeout=300)
        self.assertEqual(result.returncode, status, result.stdout + result.stderr)
        return result

    def test_back_up_while_a_robot_drives_then_restore(self):
        server = self.server("data", "--backup-dir", self.folder)
        self.make_site(server)
        self.replay(server, DRIVE)
        voxels = self.full_map(server)
        robot = start(server, "soundmap-robot", *self.replay_arguments(DRIVES / "drive.mcap", robot="busy"))
        while sum(int(session["received"]) for session in self.session_list(server)) < 300 and robot.poll() is None:
            pass
        self.assertIn("monday", self.ok(server, "soundmap", "backup", "monday"))
        self.refused(server, "soundmap", "backup", "monday", says="exists already")
        self.refused(server, "soundmap", "backup", "../monday", says="../monday")
        robot.communicate()
        self.assertEqual(robot.returncode, 0)
        after = self.full_map(server)
        self.assertEqual(server.stop(), 0)
        self.assertIn("no fault", self.tool("--check", "--data-dir", self.folder / "data").stdout)

        self.tool("--restore", self.folder / "monday", "--data-dir", self.folder / "restored")
        self.tool("--restore", self.folder / "monday", "--data-dir", self.folder / "restored", status=1)
        server = self.server("restored")
        # The drive goes on where the backup ends, and the map becomes what it would have been.
        self.ok(server, "soundmap-robot", *self.replay_arguments(DRIVES / "drive.mcap", robot="busy"))
        self.assertNotEqual(after, voxels)
        self.assertEqual(self.full_map(server), after)

    def test_a_server_without_a_folder_for_backups(self):
        self.refused(self.server(), "soundmap", "backup", "monday", says="--backup-dir")

    def test_damage_is_named_by_the_check(self):
        server = self.server()
        self.make_site(server)
        self.replay(server, DRIVE)
        self.refuse_check("is in use")
        self.assertEqual(server.stop(), 0)
        self.assertIn("no fault", self.tool("--check", "--data-dir", server.data_dir).stdout)
        segment = max((server.data_dir / "sessions" / "site").rglob("*.mcap"), key=lambda path: path.stat().st_size)
        whole = segment.read_bytes()
        middle = len(whole) // 2
        segment.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1:])
        self.refuse_check(str(segment))
        segment.write_bytes(whole)
        # What the database logged goes into tables when it is opened again.
        self.assertEqual(self.server().stop(), 0)
        table = max((server.data_dir / "db").glob("*.sst"), key=lambda path: path.stat().st_size)
        content = table.read_bytes()
        table.write_bytes(content[:20] + bytes([content[20] ^ 1]) + content[21:])
        self.refuse_check(table.name)
        table.write_bytes(content)
        self.server()

    def refuse_check(self, says):
        self.assertIn(says, self.tool("--check", "--data-dir", self.folder / "data", status=1).stderr)


if __name__ == "__main__":
    unittest.main()
