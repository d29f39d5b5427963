#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`holdfast calibrate` on sets of images as people take them, from the virtual microscope: each
fault ends with its exit code and one line that names it, and leaves no file."""
import json
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

HOLDFAST_SIM = sys.argv.pop()
HOLDFAST = sys.argv.pop()
PAIRS = 7


def render(folder, calibration="", faults=""):
    """One zoom of the virtual microscope's calibration images."""
    config = folder + ".toml"
    with open(config, "w") as file:
        file.write(f"[calibration]\nzoom_first = 1.3\nzoom_count = 1\npairs = {PAIRS}\n"
                   f"{calibration}\n[faults]\n{faults}\n")
    subprocess.run([HOLDFAST_SIM, "or", "--config", config, "--what", "calibration", "--out",
                    folder], check=True, capture_output=True)
    return folder


class CalibrationFaults(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.good = render(os.path.join(cls.folder.name, "good"))

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def copy(self):
        """The good set, with the zoom's folder to spoil."""
        images = os.path.join(self.folder.name, self.id())
        shutil.copytree(self.good, images)
        return images, os.path.join(images, "zoom_1.3")

    def calibrate(self, images, *options):
        out = os.path.join(self.folder.name, self.id() + ".yaml")
        run = subprocess.run([HOLDFAST, "calibrate", "--images", images, "--out", out, "--json",
                              *options], capture_output=True, text=True, timeout=240)
        return run, out

    def assert_refused(self, code, words, images, *options):
        run, out = self.calibrate(images, *options)
        self.assertEqual(run.returncode, code, run.stderr)
        self.assertEqual(run.stderr.count("\n"), 1, run.stderr)
        for word in words:
            self.assertIn(word, run.stderr)
        self.assertEqual(run.stdout, "")
        self.assertFalse(os.path.exists(out))

    def test_the_set_without_a_fault_is_calibrated(self):
        run, out = self.calibrate(self.good)
        self.assertEqual(run.returncode, 0, run.stderr)
        report = json.loads(run.stdout)
        self.assertEqual(report["zooms"][0]["pairs_used"], PAIRS)
        self.assertTrue(os.path.exists(out))

    def test_swapped_sides(self):
        images, zoom = self.copy()
        for name in os.listdir(zoom):
            if name.startswith("left"):
                right = os.path.join(zoom, name.replace("left", "right"))
                left, spare = os.path.join(zoom, name), os.path.join(zoom, "spare")
                os.rename(left, spare)
                os.rename(right, left)
                os.rename(spare, right)
        self.assert_refused(1, ["zoom 1.3", "left and right are swapped"], images)

    def test_one_pair_swapped(self):
        images, zoom = self.copy()
        left, right = os.path.join(zoom, "left_03.png"), os.path.join(zoom, "right_03.png")
        os.rename(left, left + "_")
        os.rename(right, left)
        os.rename(left + "_", right)
        self.assert_refused(1, ["left_03.png", "left and right are swapped"], images)

    def test_a_right_image_is_missing(self):
        images, zoom = self.copy()
        os.remove(os.path.join(zoom, "right_02.png"))
        self.assert_refused(1, ["left_02.png", "has no right image"], images)

    def test_another_board(self):
        self.assert_refused(1, ["shows 9x5 corners, not 8x6"], self.good, "--board", "8x6")

    def test_another_square_size(self):
        self.assert_refused(1, ["the squares are not 6 mm"], self.good, "--square-mm", "6",
                            "--focus-mm", "200")

    def test_boards_partly_out_of_view(self):
        images = render(os.path.join(self.folder.name, "edge"), "border_px = -700\npose_seed = 2")
        self.assert_refused(1, ["zoom 1.3", "pairs show the whole board, at least 6"], images)

    def test_views_all_alike(self):
        images = render(os.path.join(self.folder.name, "alike"), faults="similar_views = true")
        self.assert_refused(1, ["zoom 1.3", "do not constrain the model"], images)

    def test_a_smeared_view_is_left_out_or_does_no_harm(self):
        images = render(os.path.join(self.folder.name, "smeared"), faults="smeared_view = 1")
        run, _ = self.calibrate(images)
        self.assertEqual(run.returncode, 0, run.stderr)
        report = json.loads(run.stdout)
        good, _ = self.calibrate(self.good)
        limit = 2 * json.loads(good.stdout)["zooms"][0]["rms"]["board_mm"]
        self.assertLess(report["zooms"][0]["rms"]["board_mm"], limit)

    def test_a_folder_without_zooms(self):
        empty = os.path.join(self.folder.name, "empty")
        os.mkdir(empty)
        self.assert_refused(2, ["holds no folder zoom_<number>"], empty)


if __name__ == "__main__":
    unittest.main()
