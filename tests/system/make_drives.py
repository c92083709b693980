"""Simulates the drives that the system tests replay: the grill room, shortened, and the same with one thing wrong each."""

import array
import json
import math
import operator
import pathlib
import random
import subprocess
import wave

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


def room_with(name, **sections):
    """The grill room with other sections; its path."""
    path = DRIVES / f"{name}.json"
    path.write_text(json.dumps(json.loads((SCENES / "grill_room.json").read_text()) | sections))
    return path


def write_noise(name, low_hz, high_hz, rate_hz=16000, seconds=2):
    """Noise of a band, with next to nothing outside of it, as a .wav; its path."""
    taps = 401
    middle = taps // 2
    def low_pass(hz, i):
        return 2 * hz / rate_hz if i == middle else math.sin(2 * math.pi * hz / rate_hz * (i - middle)) / (math.pi * (i - middle))
    kernel = [(low_pass(high_hz, i) - low_pass(low_hz, i)) * (0.42 - 0.5 * math.cos(2 * math.pi * i / (taps - 1)) + 0.08 * math.cos(4 * math.pi * i / (taps - 1)))
              for i in range(taps)]
    generator = random.Random(name)
    noise = [generator.gauss(0, 1) for _ in range(seconds * rate_hz)]
    # Around the end to the beginning: it is played again and again.
    samples = [sum(map(operator.mul, kernel, window)) for window in
               ((noise[i:i + taps] if i + taps <= len(noise) else noise[i:] + noise[:i + taps - len(noise)]) for i in range(len(noise)))]
    scale = 8000 / math.sqrt(sum(sample * sample for sample in samples) / len(samples))
    path = DRIVES / f"{name}.wav"
    with wave.open(str(path), "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(rate_hz)
        out.writeframes(array.array("h", (max(-32768, min(32767, round(scale * sample))) for sample in samples)).tobytes())
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
    room = json.loads((SCENES / "grill_room.json").read_text())
    stopping = [*room["sources"][:2], room["sources"][2] | {"off_s": 18}, *room["sources"][3:]]
    simulate(room_with("stopping", sources=stopping), "stopping", "--seconds", "50")
    # Two sources; later one of them elsewhere; another drive; two people, with and without them.
    pair = [room["sources"][0], room["sources"][5]]
    people = [{"way_points": [[1.2, 3.4], [2.6, 4.6], [8.6, 4.8]], "speed_mps": 1.0},
              {"way_points": [[7.4, 1.2], [7.6, 5.4], [3.0, 6.2]], "speed_mps": 0.8}]
    simulate(room_with("pair", sources=pair), "pair", "--seconds", "40")
    simulate(room_with("pair_again", sources=pair, seed=2), "pair_again", "--seconds", "40")
    simulate(room_with("pair_moved", sources=[pair[0], room["sources"][4]], seed=3, start_time_s=1.7e9 + 3600), "pair_moved", "--seconds", "60")
    simulate(room_with("pair_people", sources=pair, people=people), "pair_people", "--seconds", "40")
    simulate(room_with("people", sources=[], people=people), "people", "--seconds", "40")
    # One that hisses and one of a low pitch, neither of which has anything of the other's frequencies.
    hiss, low = (room["sources"][i] | {"kind": write_noise(name, *edges_hz).name}
                 for i, name, edges_hz in ((0, "hiss", (4500, 7500)), (5, "low", (800, 2800))))
    simulate(room_with("two_pitches", sources=[hiss, low]), "two_pitches", "--seconds", "40")
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
