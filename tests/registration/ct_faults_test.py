#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`holdfast surface` on DICOM folders as hospitals produce them, written by pydicom: each fault is
refused in one line that names it, or comes out in true patient coordinates."""
import copy
import json
import os
import subprocess
import sys
import tempfile
import unittest

import numpy
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.pixel_data_handlers.rle_handler import rle_encode_frame
from pydicom.uid import (DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian, ExplicitVRLittleEndian,
                         ImplicitVRLittleEndian, RLELossless)

HOLDFAST = sys.argv.pop()
CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"
COLUMNS, ROWS, SLICES, PIXEL_MM, STEP_MM, RADIUS_MM = 40, 36, 30, 0.8, 0.6, 7.0
CENTRE_MM = numpy.array([21.3, -17.8, 109.1])  # of the ball, LPS


def plane(kind):
    """Directions of a row and a column, and the step from slice to slice."""
    tilt = numpy.radians(12)
    if kind == "tilted":  # the gantry leans, the table moves along z
        return (1, 0, 0), (0, numpy.cos(tilt), numpy.sin(tilt)), (0, 0, STEP_MM)
    if kind == "feet_first":  # row x column points to the feet
        return (-1, 0, 0), (0, 1, 0), (0, 0, -STEP_MM)
    if kind == "coronal":
        return (1, 0, 0), (0, 0, -1), (0, STEP_MM, 0)
    return (1, 0, 0), (0, 1, 0), (0, 0, STEP_MM)


def series(kind="axial"):
    """A ball of 1000 HU in air, one dataset a slice."""
    row, column, step = (numpy.array(v, float) for v in plane(kind))
    origin = (CENTRE_MM - row * PIXEL_MM * (COLUMNS - 1) / 2 - column * PIXEL_MM * (ROWS - 1) / 2
              - step * (SLICES - 1) / 2)
    study, series_uid, frame = (pydicom.uid.generate_uid() for _ in range(3))
    i, j = numpy.meshgrid(numpy.arange(COLUMNS), numpy.arange(ROWS))
    slices = []
    for k in range(SLICES):
        position = origin + k * step
        p = (position + i[..., None] * PIXEL_MM * row + j[..., None] * PIXEL_MM * column) - CENTRE_MM
        hu = numpy.clip(-1000 + 1000 * (RADIUS_MM + 1 - numpy.linalg.norm(p, axis=-1)), -1000, 1000)
        s = Dataset()
        s.SOPClassUID, s.SOPInstanceUID = CT_IMAGE, pydicom.uid.generate_uid()
        s.Modality, s.ImageType = "CT", ["ORIGINAL", "PRIMARY", "AXIAL"]
        s.PatientName, s.PatientID = "Test^Ball", "B1"
        s.StudyInstanceUID, s.SeriesInstanceUID, s.FrameOfReferenceUID = study, series_uid, frame
        s.SeriesDescription, s.InstanceNumber = "ball", SLICES - k
        s.ImagePositionPatient = [f"{v:.6f}" for v in position]
        s.ImageOrientationPatient = [f"{v:.8f}" for v in (*row, *column)]
        s.PixelSpacing, s.SliceThickness = [PIXEL_MM, PIXEL_MM], STEP_MM
        s.Rows, s.Columns, s.SamplesPerPixel = ROWS, COLUMNS, 1
        s.PhotometricInterpretation = "MONOCHROME2"
        s.BitsAllocated, s.BitsStored, s.HighBit, s.PixelRepresentation = 16, 16, 15, 0
        s.RescaleSlope, s.RescaleIntercept = 1, -1024
        s.PixelData = (numpy.rint(hu) + 1024).astype("<u2").tobytes()
        s["PixelData"].VR = "OW"
        slices.append(s)
    return slices


def save(dataset, path, syntax=ExplicitVRLittleEndian):
    dataset = copy.deepcopy(dataset)
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = syntax
    dataset.is_implicit_VR = syntax == ImplicitVRLittleEndian
    dataset.is_little_endian = syntax != ExplicitVRBigEndian
    pixels = numpy.frombuffer(dataset.PixelData, "<u2") if "PixelData" in dataset else None
    if syntax == ExplicitVRBigEndian:
        dataset.PixelData = pixels.astype(">u2").tobytes()
    if syntax == RLELossless:
        dataset.PixelData = encapsulate([rle_encode_frame(pixels.reshape(dataset.Rows, dataset.Columns))])
        dataset["PixelData"].VR = "OB"
        dataset["PixelData"].is_undefined_length = True
    dataset.save_as(path, write_like_original=False)


class CtFaults(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.dicom = os.path.join(self.folder.name, "ct")
        self.out = os.path.join(self.folder.name, "ct.ply")
        os.mkdir(self.dicom)

    def write(self, slices, syntax=ExplicitVRLittleEndian, prefix="s"):
        for k, s in enumerate(slices):
            save(s, os.path.join(self.dicom, f"{prefix}{(k * 17) % 1000:03d}.dcm"), syntax)

    def run_surface(self, *more):
        return subprocess.run([HOLDFAST, "surface", "--dicom", self.dicom, "--iso", "0", "--out", self.out,
                               "--json", *more], capture_output=True, text=True, check=False, timeout=60)

    def refused(self, code, *words, more=()):
        done = self.run_surface(*more)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertEqual(done.stdout, "")
        self.assertFalse(os.path.exists(self.out))
        for word in words:
            self.assertIn(word, done.stderr)

    def accepted(self, *more, note=None):
        """Runs; the surface must be the ball, outside out, to 0.05 mm."""
        done = self.run_surface(*more)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        result = json.loads(done.stdout)
        with open(self.out, "rb") as stream:
            content = stream.read()
        start = content.index(b"end_header\n") + 11
        points = numpy.frombuffer(content, "<f4", 3 * result["vertices"], start).reshape(-1, 3) - CENTRE_MM
        faces = numpy.frombuffer(content, numpy.dtype([("n", "u1"), ("v", "<i4", 3)]), result["triangles"],
                                 start + points.shape[0] * 12)["v"]
        self.assertGreater(len(points), 1000)
        self.assertLess(numpy.abs(numpy.linalg.norm(points, axis=1) - RADIUS_MM).max(), 0.05)
        self.assertLess(numpy.abs(points.min(0) + points.max(0)).max(), 0.1)
        a, b, c = (points[faces[:, k]] for k in range(3))
        volume = numpy.einsum("ij,ij->i", a, numpy.cross(b, c)).sum() / 6
        self.assertGreater(volume, 0.95 * 4 / 3 * numpy.pi * RADIUS_MM**3)
        if note:
            self.assertTrue(any(note in n for n in result["notes"]), result["notes"])
        return result

    def test_true_patient_coordinates_in_every_orientation(self):
        for kind in ("axial", "tilted", "feet_first", "coronal"):
            with self.subTest(kind):
                self.setUp()
                self.write(series(kind))
                self.accepted(note="tilted by 12.00 degrees" if kind == "tilted" else None)

    def test_transfer_syntaxes(self):
        for syntax in (ImplicitVRLittleEndian, ExplicitVRBigEndian, RLELossless):
            with self.subTest(syntax.name):
                self.setUp()
                self.write(series(), syntax)
                self.accepted()

    def test_codecs_of_gdcmconv(self):
        for option in ("--jpeg", "--jpegls", "--j2k"):
            with self.subTest(option):
                self.setUp()
                self.write(series())
                for name in os.listdir(self.dicom):
                    path = os.path.join(self.dicom, name)
                    subprocess.run(["gdcmconv", option, path, path + ".x"], check=True, capture_output=True)
                    os.replace(path + ".x", path)
                self.accepted()

    def test_signed_12_bit_and_rescale_per_slice(self):
        slices = series()
        for s in slices[:15]:
            hu = numpy.frombuffer(s.PixelData, "<u2").astype(int) - 1024
            s.PixelRepresentation, s.BitsStored, s.HighBit, s.RescaleIntercept = 1, 12, 11, 0
            s.PixelData = (hu & 0x0FFF).astype("<u2").tobytes()
        self.write(slices)
        self.accepted()

    def test_missing_slices_are_listed(self):
        slices = series()
        gone = [slices.pop(12), slices.pop(12)]
        self.write(slices)
        self.refused(1, "2 slice(s) missing", f"{float(gone[0].ImagePositionPatient[2]):.3f}",
                     f"{float(gone[1].ImagePositionPatient[2]):.3f}")

    def test_duplicates(self):
        slices = series()
        twin = copy.deepcopy(slices[4])
        self.write(slices)
        self.write([twin], prefix="twin")
        self.accepted(note="left out twin000.dcm: the same slice as")
        os.remove(self.out)
        twin.PixelData = b"\0\0" + twin.PixelData[2:-2] + b"\1\1"
        self.write([twin], prefix="twin")
        self.refused(1, "twin000.dcm", "one position with different pixels")

    def test_several_series_need_a_choice(self):
        first, second = series(), series("tilted")
        for s in second:
            s.SeriesDescription = "tilted ball"
        self.write(first)
        self.write(second, prefix="t")
        uid = first[0].SeriesInstanceUID
        self.refused(1, uid, second[0].SeriesInstanceUID, "'tilted ball', 30 slices")
        self.refused(2, "1.2.3.4", uid, more=("--series", "1.2.3.4"))
        self.assertEqual(self.accepted("--series", uid)["series"], uid)

    def test_what_one_series_may_not_mix(self):
        def change(**values):
            def apply(slices):
                for key, value in values.items():
                    setattr(slices[7], key, value)
            return apply

        def crop(slices):
            slices[7].Rows, slices[7].PixelData = 18, slices[7].PixelData[: 18 * COLUMNS * 2]

        def rows(count):
            def apply(slices):
                for s in slices:
                    s.Rows = count
            return apply

        def tilt_tag(slices):
            for s in slices:
                s.GantryDetectorTilt = 12

        def aside(slices):
            x, y, z = slices[7].ImagePositionPatient
            slices[7].ImagePositionPatient = [float(x) + 0.2, y, z]

        def up(slices):
            x, y, z = slices[7].ImagePositionPatient
            slices[7].ImagePositionPatient = [x, y, float(z) + 0.1]

        cases = [
            (change(PatientName="Other^One", PatientID="B2"), ("two patients", "Other", "B2")),
            (change(FrameOfReferenceUID="1.2.3"), ("FrameOfReferenceUID", "1.2.3")),
            (change(StudyInstanceUID="1.2.3"), ("StudyInstanceUID", "1.2.3")),
            (change(ImageOrientationPatient=[1, 0, 0, 0, 0.9998, 0.02]), ("ImageOrientationPatient",)),
            (change(ImageOrientationPatient=[1, 0, 0, 0, 2, 0]), ("unit length",)),
            (change(ImageOrientationPatient=[1, 0, 0, 1, 0, 0]), ("perpendicular",)),
            (change(PixelSpacing=[0.8, 0.81]), ("PixelSpacing",)),
            (change(PixelSpacing=[0, 0]), ("PixelSpacing", "0.01 to 10")),
            (change(ImagePositionPatient=None), ("ImagePositionPatient",)),
            (change(RescaleSlope=None), ("RescaleSlope",)),
            (change(RescaleType="US"), ("RescaleType",)),
            (change(PhotometricInterpretation="RGB"), ("PhotometricInterpretation",)),
            (change(BitsStored=17), ("BitsStored",)),
            (rows(35), ("must be",)),
            (rows(37), ("truncated",)),
            (change(NumberOfFrames=2), ("NumberOfFrames",)),
            (crop, ("40x18",)),
            (aside, ("beside the line",)),
            (up, ("apart",)),
            (tilt_tag, ("GantryDetectorTilt", "cannot be resolved")),
        ]
        for apply, words in cases:
            with self.subTest(words[0]):
                self.setUp()
                slices = series()
                apply(slices)
                self.write(slices)
                self.refused(1, *words)

    def test_truncated_file_is_named(self):
        self.write(series())
        path = os.path.join(self.dicom, "s017.dcm")
        whole = os.path.getsize(path)
        for size in (whole - 100, 700, 200):
            with self.subTest(size):
                os.truncate(path, size)
                self.refused(1, "s017.dcm")

    def test_broken_compressed_pixels_are_named_in_one_line(self):
        self.write(series())
        path = os.path.join(self.dicom, "s017.dcm")
        for option in ("--jpeg", "--jpegls", "--j2k"):
            with self.subTest(option):
                subprocess.run(["gdcmconv", option, path, path + ".x"], check=True, capture_output=True)
                with open(path + ".x", "r+b") as stream:
                    size = stream.seek(0, os.SEEK_END)
                    stream.seek(size - 700)
                    stream.write(b"\xff\x90" * 300)
                os.replace(path, path + ".good")
                os.replace(path + ".x", path)
                kept = path + ".good"
                os.rename(kept, os.path.join(self.folder.name, "good"))
                self.refused(1, "s017.dcm")
                os.replace(os.path.join(self.folder.name, "good"), path)

    def test_unsupported_syntaxes_are_named(self):
        self.write(series())
        save(series()[0], os.path.join(self.dicom, "s000.dcm"), DeflatedExplicitVRLittleEndian)
        self.refused(1, "s000.dcm", "1.2.840.10008.1.2.1.99")

    def test_other_files_are_left_out_with_a_note(self):
        self.write(series())
        scout = series()[0]
        scout.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
        report = series()[0]
        report.SOPClassUID, report.Modality = "1.2.840.10008.5.1.4.1.1.88.11", "SR"
        del report.PixelData
        self.write([scout], prefix="scout")
        self.write([report], prefix="report")
        with open(os.path.join(self.dicom, "readme.txt"), "w", encoding="ascii") as stream:
            stream.write("hello")
        open(os.path.join(self.dicom, "empty"), "w", encoding="ascii").close()
        notes = self.accepted(note="1 localizer(s): scout000.dcm")["notes"]
        self.assertTrue(any("report000.dcm" in n for n in notes), notes)
        self.assertTrue(any("empty, readme.txt" in n for n in notes), notes)

    def test_no_dicom_and_bad_usage(self):
        self.refused(2, "holds no CT slice")
        self.write(series())
        self.refused(2, "--roi", more=("--roi", "1,1,1,0,0,0"))
        self.refused(1, "outside the CT", more=("--roi", "900,900,900,910,910,910"))
        self.refused(1, "no surface", more=("--roi", "21,-18,109,21.5,-17.5,109.5"))
        self.refused(2, "--iso", more=("--iso", "nan"))
        self.dicom = os.path.join(self.folder.name, "none")
        self.refused(2, "is not a folder")

    def test_roi_stl_and_identity(self):
        slices = series()
        self.write(slices)
        low = CENTRE_MM
        roi = ",".join(f"{v}" for v in (*low, *(low + 20)))
        done = self.run_surface("--roi", roi)
        self.assertEqual(done.returncode, 0, done.stderr)
        bounds = json.loads(done.stdout)["bounds_mm"]
        self.assertTrue((numpy.array(bounds[0]) >= low - 1e-4).all())
        with open(self.out, "rb") as stream:
            header = stream.read(400)
        self.assertIn(b"comment ct_series " + slices[0].SeriesInstanceUID.encode(), header)
        self.assertIn(b"comment ct_frame_of_reference " + slices[0].FrameOfReferenceUID.encode(), header)
        self.out = os.path.join(self.folder.name, "ct.stl")
        done = self.run_surface()
        self.assertEqual(os.path.getsize(self.out), 84 + 50 * json.loads(done.stdout)["triangles"])


if __name__ == "__main__":
    unittest.main()
