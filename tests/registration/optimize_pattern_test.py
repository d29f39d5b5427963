#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`holdfast optimize-pattern` with a rig of a few lines: a plane, seen without parallax between the
views, whose blur and noise spoil fine dots. This file is both the test and, as `... rig`, the rig."""
import json
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
from skimage import filters, io

WIDTH, HEIGHT, FOCAL, BASE, DEPTH = 480, 384, 2000.0, 24.0, 200.0
HOLDFAST = None


def take(pattern, out):
    """Both views are the pattern at 1.6 pixels for one of its own, each with its own noise."""
    dots = io.imread(pattern)[:, :, 0] if io.imread(pattern).ndim == 3 else io.imread(pattern)
    y = (np.arange(HEIGHT) / 1.6).astype(int)
    x = (np.arange(WIDTH) / 1.6).astype(int)
    clear = filters.gaussian(dots[np.ix_(y, x)].astype(float), 2.5)
    random = np.random.default_rng(int(dots.sum()))
    for name in ("left", "right"):
        image = 30 + 0.6 * clear + random.normal(0, 3, clear.shape)
        io.imsave(f"{out}/{name}.png", np.clip(image, 0, 255).astype(np.uint8),
                  check_contrast=False)


def rig():
    for line in sys.stdin:
        wanted = json.loads(line)
        if wanted["do"] == "pair" and not wanted["off"]:
            take(wanted["pattern"], wanted["out"])
            print('{"files": 2}', flush=True)
        else:
            print('{"error": "only pairs"}', flush=True)


def matrix(name, values, rows, columns):
    data = ", ".join(repr(float(v)) for v in values)
    return (f"      {name}: !!opencv-matrix\n         rows: {rows}\n         cols: {columns}\n"
            f"         dt: d\n         data: [ {data} ]\n")


def write_setup(folder):
    cx = WIDTH / 2 - FOCAL * BASE / DEPTH / 2
    text = (f"%YAML:1.0\n---\nimage_width: {WIDTH}\nimage_height: {HEIGHT}\nzooms:\n   -\n"
            f"      zoom: 1.0\n      focus_mm: {DEPTH}\n")
    for side, centre in (("left", cx), ("right", cx + FOCAL * BASE / DEPTH)):
        text += matrix(f"camera_matrix_{side}",
                       [FOCAL, 0, centre, 0, FOCAL, HEIGHT / 2, 0, 0, 1], 3, 3)
        text += matrix(f"distortion_{side}", [0] * 5, 1, 5)
    text += matrix("R", np.eye(3).ravel(), 3, 3) + matrix("T", [-BASE, 0, 0], 3, 1)
    with open(f"{folder}/stereo.yaml", "w") as file:
        file.write(text + "      rms_px: 0.03\n      pairs_used: 19\n")
    with open(f"{folder}/plane.ply", "w") as file:
        file.write("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
                   "property float z\nelement face 2\nproperty list uchar int vertex_indices\n"
                   "end_header\n")
        for x, y in ((-90, -90), (90, -90), (90, 90), (-90, 90)):
            file.write(f"{x} {y} {DEPTH}\n")
        file.write("3 0 1 2\n3 0 2 3\n")
    with open(f"{folder}/T_1.tfm", "w") as file:
        file.write("#Insight Transform File V1.0\n#Transform 0\n"
                   "Transform: AffineTransform_double_3_3\n"
                   "Parameters: 1 0 0 0 1 0 0 0 1 0 0 0\nFixedParameters: 0 0 0\n")


class OptimizePattern(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        write_setup(self.folder.name)

    def run_it(self, name, *more, rig_command=None):
        f = self.folder.name
        command = rig_command or f"{sys.executable} {os.path.abspath(__file__)} rig"
        return subprocess.run(
            [HOLDFAST, "optimize-pattern", "--rig", command, "--calibration", f"{f}/stereo.yaml",
             "--zooms", "1", "--reference", f"{f}/plane.ply", "--transform", f + "/T_{zoom}.tfm",
             "--out", f"{f}/{name}.toml", "--csv", f"{f}/{name}.csv", "--json", *more],
            capture_output=True, text=True)

    def read(self, name):
        with open(f"{self.folder.name}/{name}") as file:
            return file.read()

    def test_resumes_and_repeats_itself(self):
        first = self.run_it("a", "--evaluations", "3")
        self.assertEqual(first.returncode, 0, first.stderr)
        rows = self.read("a.csv")
        self.assertEqual(len(rows.splitlines()), 2 + 3)
        second = self.run_it("a", "--evaluations", "6")
        self.assertEqual(second.returncode, 0, second.stderr)
        self.assertTrue(self.read("a.csv").startswith(rows), "what was known is kept")
        whole = self.run_it("b", "--evaluations", "6")
        self.assertEqual(whole.returncode, 0, whole.stderr)
        self.assertEqual(self.read("a.csv"), self.read("b.csv"))
        self.assertEqual(self.read("a.toml"), self.read("b.toml"))
        self.assertIn("[[pattern]]\nzoom = 1", self.read("a.toml"))
        values = [float(row.split(",")[4]) for row in self.read("a.csv").splitlines()[2:]]
        self.assertLess(min(values), 0.2)
        self.assertGreater(max(values), 1.2 * min(values), "the dots matter")

    def test_refuses_the_csv_of_another_search(self):
        self.assertEqual(self.run_it("a", "--evaluations", "1").returncode, 0)
        other = self.run_it("a", "--evaluations", "1", "--paper")
        self.assertEqual(other.returncode, 2)
        self.assertIn("of another search", other.stderr)
        self.assertEqual(len(other.stderr.splitlines()), 1)

    def test_names_a_rig_that_fails(self):
        mute = "sh -c false"
        for command in (mute, "/does/not/exist"):
            failed = self.run_it("a", rig_command=command)
            self.assertEqual(failed.returncode, 3, failed.stderr)
            self.assertIn("--rig", failed.stderr)
            self.assertFalse(os.path.exists(f"{self.folder.name}/a.toml"))
        lost = self.run_it("a", rig_command=f"{sys.executable} /does/not/exist.py")
        self.assertEqual(lost.returncode, 3, lost.stderr)
        self.assertIn("No such file", lost.stderr, "its own last line is passed on")
        self.assertEqual(len(lost.stderr.splitlines()), 1)

    def test_passes_a_rigs_refusal_on(self):
        refusal = "read _; echo '{\"error\": \"the lamp is dead\"}'"
        script = f"{self.folder.name}/rig.sh"
        with open(script, "w") as file:
            file.write(refusal + "\n")
        refused = self.run_it("a", rig_command=f"sh {script}")
        self.assertEqual((refused.returncode, refused.stderr), (1, "holdfast: rig: the lamp is dead\n"))


if __name__ == "__main__":
    if sys.argv[1] == "rig":
        rig()
        sys.exit(0)
    HOLDFAST = sys.argv.pop(1)
    unittest.main()
