#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`holdfast study` and `holdfast demo --setup` on the virtual rig, small: one zoom, one repeat.

usage: study_test.py HOLDFAST HOLDFASTD OR_CONFIG_DIR"""
import csv
import json
import pathlib
import re
import subprocess
import sys
import tempfile

HOLDFAST, HOLDFASTD, CONFIG = sys.argv[1:4]
failures = []


def check(is_so, what):
    print(("ok    " if is_so else "WRONG ") + what, flush=True)
    if not is_so:
        failures.append(what)


def run(*words, program=HOLDFAST):
    done = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def is_one_line(text):
    return text.count("\n") == 1 and text.endswith("\n")


def study(folder):
    small = ["study", "--out", folder, "--zooms", "1.3", "--repeats", "1", "--pairs", "12"]
    code, out, err = run(*small, "--json")
    check(code == 0 and err == "", f"the study ends well and silently ({code}: {err.strip()})")
    result = json.loads(out)
    check(result["reconstructions"] == 8, "4 illuminations x 2 methods are 8 reconstructions")

    rows = list(csv.DictReader(open(folder / "results.csv")))
    by = {(row["illumination"], row["method"]): row for row in rows}
    check(len(by) == 8, "each has its own row")
    number = lambda key, name: float(by[key][name] or "nan")
    ours, theirs = ("adaptive", "sgm"), ("adaptive", "opencv")
    check(by[ours]["refusal"] == "", f"ours under the pattern is measured ({by[ours]['refusal']})")
    check(number(ours, "closest_mean_mm") < 0.5, "... near the CT: "
          + by[ours]["closest_mean_mm"] + " mm to the nearest vertex")
    check(number(ours, "triangle_mean_mm") < number(ours, "closest_mean_mm"),
          "... and nearer to its triangles than to its vertices")
    check(number(ours, "truth_median_mm") < 0.15,
          "... and near the truth: " + by[ours]["truth_median_mm"] + " mm median")
    check(number(ours, "coverage") > 0.8, "... over most of the ear: " + by[ours]["coverage"])
    check(number(ours, "truth_over_1_mm") < number(("or_light", "opencv"), "truth_over_1_mm"),
          "... with fewer wrong points than OpenCV without a pattern")
    check(number(theirs, "time_ms") > 0, "OpenCV ran in the same study")
    for key, row in by.items():
        is_measured = row["truth_median_mm"] != "" and row["coverage"] != ""
        check(is_measured or row["refusal"] != "", f"{key}: beside the closest points stands the "
              "truth, or a reason")

    html = (folder / "report.html").read_text()
    links = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]{0,20})""", html)
    check(links and all(link.startswith("data:image/png;base64") for link in links),
          f"the page needs no other file ({len(links)} pictures inside)")
    check("<script" not in html and "Not for clinical use" in html and "Limits" in html,
          "it runs nothing and states its limits")
    check("0.5 ± 0.3" in html and 'class="q"' in html, "the paper's figures are marked as quoted")
    check(not re.search(r"\bnan\b|\binf\b", html), "no figure that is none")

    before = (folder / "results.csv").read_bytes(), html
    code, out, err = run(*small, "--json", "--rig", "/no/such/rig")
    check(code == 0 and json.loads(out)["resumed_pairs"] == 4,
          f"gone on with: nothing is rendered again ({err.strip()})")
    check(before == ((folder / "results.csv").read_bytes(), (folder / "report.html").read_text()),
          "... and comes out the same")
    code, out, err = run(*small, "--points", "4000")
    check(code == 2 and is_one_line(err) and "points" in err,
          f"other settings in the same folder are refused: {err.strip()}")
    code, out, err = run("study", "--out", folder / "none", "--rig", "/no/such/rig")
    check(code == 3 and is_one_line(err), f"a rig that is not there: {err.strip()}")


def setup(folder):
    code, out, err = run("demo", "--setup", "--out", folder, "--pairs", "12", "--json")
    check(code == 0 and err == "", f"the set-up registers, silently ({code}: {err.strip()})")
    result = json.loads(out)
    check([stage["name"] for stage in result["stages"]] ==
          ["calibration", "CT", "pattern", "reconstruction", "registration"], "in five stages")
    check(result["refusal"] is None and 0 < result["fre_mm"] < 0.3, f"FRE {result['fre_mm']} mm")
    check(all(0 < rms < 1 for rms in result["predicted_tre_mm"].values()),
          f"predicted TRE {result['predicted_tre_mm']} mm")

    config = (pathlib.Path(CONFIG) / "holdfastd.toml").read_text()
    config = config.replace("width_px = 1920", "width_px = 2456")
    config = config.replace("height_px = 1080", "height_px = 2054")
    (folder / "holdfastd.toml").write_text(config)
    daemon = ["--config", folder / "holdfastd.toml", "--check"]
    code, out, err = run(*daemon, program=HOLDFASTD)
    check(code == 0, f"the daemon loads it ({err.strip()})")
    with open(folder / "depth.tiff", "r+b") as depth:
        depth.seek(1_000_000)
        depth.write(b"\0\0\x80?")
    code, out, err = run(*daemon, program=HOLDFASTD)
    check(code == 2, f"... and not with another depth ({err.strip()})")

    code, out, err = run("demo", "--setup", "--out", folder, "--rig", "/bin/false")
    check(code == 3 and is_one_line(err), f"a rig that ends: {err.strip()}")
    check(not (folder / "registration.json").exists(), "... leaves no registration from before")
    code, out, err = run("demo", "--setup")
    check(code == 2 and is_one_line(err), f"usage: {err.strip()}")


def tracking(folder):
    """Paper B's experiment, its spiral a twentieth as large."""
    small = ["study", "--tracking", "--out", folder, "--scenes", "cavity_bone", "--pairs", "12"]
    code, out, err = run(*small, "--motions", "spiral:0.05", "--json")
    check(code == 0 and err == "", f"the tracking study ends well, silently ({code}: {err.strip()})")
    rows = {row["method"]: row for row in json.loads(out)["rows"]}
    check(sorted(rows) == ["direct", "orb", "paper"], "three methods on the same frames")
    check(all("refusal" not in row and row["frames"] >= 2 and row["lost"] == 0
              for row in rows.values()), f"each follows every frame ({rows})")
    ours, paper = rows["direct"], rows["paper"]
    check(ours["absolute_rms_um"] < 3, f"ours: {ours['absolute_rms_um']:.2f} um since the keyframe")
    check(ours["step_mean_um"] < paper["step_mean_um"] / 5,
          f"the paper's: {paper['step_mean_um']:.1f} um from frame to frame")
    html = (folder / "report.html").read_text()
    check("<script" not in html and "Not for clinical use" in html and "327" in html,
          "the page runs nothing and quotes the paper")
    check(not re.search(r"\bnan\b|\binf\b", html), "no figure that is none")
    code, out, err = run(*small, "--motions", "wobble")
    check(code == 1 and is_one_line(err) and "wobble" in err, f"a motion unknown: {err.strip()}")


with tempfile.TemporaryDirectory() as folder:
    study(pathlib.Path(folder) / "study")
    setup(pathlib.Path(folder) / "setup")
    tracking(pathlib.Path(folder) / "tracking")
sys.exit(1 if failures else 0)
