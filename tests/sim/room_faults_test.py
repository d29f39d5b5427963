#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a set of calibration images (the [faults] of config/or.toml), as its user
meets it: `holdfast-sim or` renders the set, `holdfast calibrate` must refuse it in one line that
names the fault, and write nothing.

Usage: room_faults_test.py HOLDFAST HOLDFAST_SIM"""
import os
import subprocess
import sys
import tempfile
import unittest

HOLDFAST_SIM = sys.argv.pop()
HOLDFAST = sys.argv.pop()
ROOM = "[calibration]\nzoom_first = 1.3\nzoom_last = 1.3\nzoom_count = 1\npairs = {}\n"
SIX, EIGHT = ROOM.format(6), ROOM.format(8)


class RoomFaults(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def refused(self, room, *words):
        config, boards, out = (os.path.join(self.folder, n) for n in ("or.toml", "boards", "s.yaml"))
        with open(config, "w") as file:
            file.write(room)
        subprocess.run([HOLDFAST_SIM, "or", "--config", config, "--what", "calibration", "--out",
                        boards, "--truth", os.path.join(self.folder, "truth.json")],
                       check=True, capture_output=True)
        done = subprocess.run([HOLDFAST, "calibrate", "--images", boards, "--out", out],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)
        for word in words:
            self.assertIn(word, done.stderr)
        self.assertFalse(os.path.exists(out))

    def test_an_image_without_its_partner(self):
        self.refused(SIX + "[faults]\nmissing_right = 2\n", "left_02.png", "right")

    def test_a_view_out_of_focus_leaves_too_few(self):
        self.refused(SIX + "[faults]\nsmeared_view = 3\n", "zoom 1.3", "5 pairs show the whole board")

    def test_boards_partly_out_of_view(self):
        self.refused(SIX + "border_px = -400\n", "zoom 1.3", "pairs show the whole board")

    def test_left_and_right_exchanged(self):
        # Eight: the reason named must not be that too few are left.
        self.refused(EIGHT + "[faults]\nswap_sides = true\n", "zoom 1.3", "left and right are swapped")

    def test_views_that_are_all_alike(self):
        self.refused(SIX + "[faults]\nsimilar_views = true\n", "zoom 1.3", "tilt the board more")


if __name__ == "__main__":
    unittest.main()
