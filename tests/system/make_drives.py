"""Simulates the drives that the system tests replay: the grill room, shortened, and the same with one thing wrong each."""

import json
import pathlib
import subprocess

from programs import BIN, DRIVES, SOURCE

SCENES = SOURCE / "robot-agent/sources/simulation/scenes"


def simulate(scene, name, *arguments):
    subprocess.run([BIN / "soundmap-robot", "simulate", scene, "--out", DRIVES / f"{name}.mcap", *arguments],
                   check=True)


def alter(name, change, altered=None):
    out = DRIVES / f"{altered or change.replace(':', '_')}.mcap"
    subprocess.run([BIN / "alter_drive", DRIVES / f"{name}.mcap", out, change], check=True)


def scene_with(name, **changes):
    """The grill room with some sections' fields changed; its path."""
    scene = json.loads((SCENES / "grill_room.json").read_text())
    for section, fields in changes.items():
        scene[section].update(fields)
    path = DRIVES / f"{name}.json"
    path.write_text(json.dumps(scene))
    return path


def main():
    DRIVES.mkdir(parents=True, exist_ok=True)
    for old in DRIVES.iterdir():
        old.unlink()
    simulate("grill_room", "mapping", "--mapping")
    simulate("grill_room", "drive", "--seconds", "25")
    simulate("grill_room", "short", "--seconds", "8")
    simulate(scene_with("fast_audio", audio={"sample_rate_hz": 48000}), "fast_audio", "--seconds", "6")
    simulate(scene_with("drifting_clock", audio={"clock_drift_ppm": 50}), "drifting_clock", "--seconds", "8")
    stopping = json.loads((SCENES / "grill_room.json").read_text())
    stopping["sources"][2]["off_s"] = 18
    (DRIVES / "stopping.json").write_text(json.dumps(stopping))
    simulate(DRIVES / "stopping.json", "stopping", "--seconds", "50")
    # An office, which looks the same from no two places.
    simulate("office", "office_mapping", "--mapping")
    simulate("office", "office", "--seconds", "40")
    alter("office", "kidnapped:12:19")
    alter("office_mapping", "no_lidar")
    alter("office_mapping", "until:30")
    alter("office_mapping", "from:20")
    alter("mapping", "no_lidar", "mapping_no_lidar")
    alter("until_30", "no_lidar", "until_30_no_lidar")
    alter("from_20", "no_lidar", "from_20_no_lidar")
    for change in ("no_audio", "microphones:0", "microphones:3", "nan_ranges", "invalid_lidar", "backwards",
                   "dead_microphone"):
        alter("short", change)


if __name__ == "__main__":
    main()
