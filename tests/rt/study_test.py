#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`holdfast study` and `holdfast demo --setup` on the virtual rig, small: one zoom, one repeat.

usage: study_test.py HOLDFAST HOLDFASTD HOLDFAST_SIM OR_CONFIG_DIR

As `study_test.py rig CACHE HOLDFAST_SIM` it is the rig that both use: holdfast-sim's, asked only
once for what both want (the same request for the same files has the same answer)."""
import csv
import hashlib
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

PAIRS = "8"
failures = []


def rig(cache, sim):
    real = subprocess.Popen([sim, "rig", "--seed", "1", "--phantom-seed", "1000"],
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    for line in sys.stdin:
        request = json.loads(line)
        out = request.pop("out", None)
        key = hashlib.sha256(json.dumps(request, sort_keys=True).encode())
        if pathlib.Path(request.get("pattern", "")).is_file():
            pattern = pathlib.Path(request["pattern"]).read_bytes()
            key = hashlib.sha256(json.dumps(request | {"pattern": ""}).encode() + pattern)
        kept = pathlib.Path(cache) / key.hexdigest()
        if out and kept.exists():
            shutil.copytree(kept, out, dirs_exist_ok=True)
            print('{"files": 0}', flush=True)
            continue
        real.stdin.write(json.dumps(request | ({"out": str(kept)} if out else {})) + "\n")
        real.stdin.flush()
        answer = real.stdout.readline()
        if out and "error" not in json.loads(answer):
            shutil.copytree(kept, out, dirs_exist_ok=True)
        print(answer, end="", flush=True)
    real.stdin.close()
    real.wait()


if sys.argv[1] == "rig":
    rig(*sys.argv[2:4])
    sys.exit(0)
HOLDFAST, HOLDFASTD, SIM, CONFIG = sys.argv[1:5]


def check(is_so, what):
    print(("ok    " if is_so else "WRONG ") + what, flush=True)
    if not is_so:
        failures.append(what)


def run(*words, program=HOLDFAST):
    start = time.monotonic()
    done = subprocess.run([program, *map(str, words)], capture_output=True, text=True)
    print(f"      {words[0]}: {time.monotonic() - start:.1f} s", flush=True)
    return done.returncode, done.stdout, done.stderr


def is_one_line(text):
    return text.count("\n") == 1 and text.endswith("\n")


def study(folder, rig_command):
    small = ["study", "--out", folder, "--zooms", "1.3", "--repeats", "1", "--pairs", PAIRS, "--shots", "2",
             "--rig", rig_command]
    code, out, err = run(*small, "--json")
    check(code == 0 and err == "", f"the study ends well and silently ({code}: {err.strip()})")
    result = json.loads(out)
    check(result["reconstructions"] == 9,
          "4 illuminations x 2 methods and a burst are 9 reconstructions")

    rows = list(csv.DictReader(open(folder / "results.csv")))
    by = {(row["illumination"], row["method"]): row for row in rows}
    check(len(by) == 9, "each has its own row")
    number = lambda key, name: float(by[key][name] or "nan")
    ours, theirs = ("adaptive", "sgm"), ("adaptive", "opencv")
    check(by[ours]["refusal"] == "", f"ours under the pattern is measured ({by[ours]['refusal']})")
    check(number(ours, "closest_mean_mm") < 0.5, "... near the CT: "
          + by[ours]["closest_mean_mm"] + " mm to the nearest vertex")
    check(number(ours, "triangle_mean_mm") < number(ours, "closest_mean_mm"),
          "... and nearer to its triangles than to its vertices")
    check(number(ours, "truth_median_mm") < 0.15,
          "... and near the truth: " + by[ours]["truth_median_mm"] + " mm median")
    check(number(ours, "coverage") > 0.93, "... over most of the ear: " + by[ours]["coverage"])
    check(number(ours, "truth_over_1_mm") < number(theirs, "truth_over_1_mm"),
          "... with fewer wrong points than OpenCV's from the same pair")
    burst = ("adaptive", "burst")
    check(number(burst, "truth_median_mm") < number(ours, "truth_median_mm"),
          "a burst is nearer to the truth: " + by[burst]["truth_median_mm"] + " mm median")
    check(number(theirs, "time_ms") > 0, "OpenCV ran in the same study")
    for key, row in by.items():
        is_measured = row["truth_median_mm"] != "" and row["coverage"] != ""
        check(is_measured or row["refusal"] != "", f"{key}: beside the closest points stands the "
              "truth, or a reason")

    html = (folder / "report.html").read_text()
    links = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]{0,30})""", html)
    check(links and all(link.startswith("data:image/png;base64") for link in links),
          f"the page needs no other file ({len(links)} pictures inside)")
    check("<script" not in html and "Not for clinical use" in html and "Limits" in html,
          "it runs nothing and states its limits")
    check("0.5 ± 0.3" in html and 'class="q"' in html, "the paper's figures are marked as quoted")
    text = re.sub(r"base64,[^\"]*", "", html)  # in a picture's letters anything may stand
    check("<td>single shot</td>" in html and "<td>burst of 2</td>" in html,
          "the burst stands beside the single shot")
    check(not re.search(r"\bnan\b|\binf\b", text), "no figure that is none: "
          f"{re.findall(r'.{0,60}(?:nan|inf).{0,20}', text)[:3]}")

    before = (folder / "results.csv").read_bytes(), html
    cells = {cell: cell.stat().st_mtime_ns for cell in (folder / "cells").iterdir()}
    code, out, err = run(*small, "--json")
    check(code == 0 and json.loads(out)["resumed_pairs"] == 4 and
          cells == {cell: cell.stat().st_mtime_ns for cell in (folder / "cells").iterdir()},
          f"gone on with: nothing is made again ({err.strip()})")
    check(before == ((folder / "results.csv").read_bytes(), (folder / "report.html").read_text()),
          "... and comes out the same")
    code, out, err = run(*small, "--points", "4000")
    check(code == 2 and is_one_line(err) and "points" in err,
          f"other settings in the same folder are refused: {err.strip()}")
    code, out, err = run("study", "--out", folder / "none", "--rig", "/no/such/rig")
    check(code == 3 and is_one_line(err), f"a rig that is not there: {err.strip()}")


def setup(folder, rig_command):
    code, out, err = run("demo", "--setup", "--out", folder, "--pairs", PAIRS, "--rig",
                         rig_command, "--json")
    check(code == 0 and err == "", f"the set-up registers, silently ({code}: {err.strip()})")
    result = json.loads(out)
    check([stage["name"] for stage in result["stages"]] ==
          ["calibration", "CT", "pattern", "reconstruction", "registration"], "in five stages")
    check(result["refusal"] is None and 0 < result["fre_mm"] < 0.3, f"FRE {result['fre_mm']} mm")
    check(all(0.02 < rms < 0.5 for rms in result["predicted_tre_mm"].values()),
          f"predicted TRE {result['predicted_tre_mm']} mm")

    config = (pathlib.Path(CONFIG) / "holdfastd.toml").read_text()
    config = config.replace("width_px = 1920", "width_px = 2456")
    config = config.replace("height_px = 1080", "height_px = 2054")
    config = config.replace('security = "keys/daemon"', "allow_unsecured = true")
    # The rig has no robot: where the camera stands in its frame is typed.
    config = config.replace('hand_eye = "hand_eye.json"', "\n".join([
        "translation_mm = [0.0, 0.0, 0.0]", "rotation_xyzw = [0.0, 0.0, 0.0, 1.0]", "sigma_t_mm = 0.05",
        "sigma_r_rad = 1e-4"]))
    (folder / "holdfastd.toml").write_text(config)
    daemon = ["--config", folder / "holdfastd.toml", "--check"]
    code, out, err = run(*daemon, program=HOLDFASTD)
    check(code == 0, f"the daemon loads it ({err.strip()})")
    (folder / "frames").mkdir()
    for frame in range(3):  # the site as it was: nothing moves
        shutil.copy(folder / "keyframe.png", folder / f"frames/{frame:02}.png")
    code, out, err = run("track", "--frames", folder / "frames", "--camera", folder / "camera.yaml",
                         "--depth", folder / "depth.tiff", "--fps", "30", "--out",
                         folder / "poses.csv", "--json")
    poses = list(csv.DictReader(open(folder / "poses.csv"))) if code == 0 else []
    check(len(poses) == 3 and all(pose["status"] == "tracking" and
                                  abs(float(pose["tx_mm"])) < 1e-3 for pose in poses),
          f"the tracker starts from its keyframe and depth ({err.strip()})")
    with open(folder / "depth.tiff", "r+b") as depth:
        depth.seek(1_000_000)
        depth.write(b"\0\0\x80?")
    code, out, err = run(*daemon, program=HOLDFASTD)
    check(code == 2 and "depth" in err, f"... and not with another depth ({err.strip()})")


def refused_setups(folder, rig_command):
    """In the folder of one that went well: nothing of it may be left to be taken for theirs."""
    code, out, err = run("demo", "--setup", "--out", folder, "--rig", "/bin/false")
    check(code == 3 and is_one_line(err), f"a rig that ends: {err.strip()}")
    check(not (folder / "registration.json").exists(), "... leaves no registration from before")
    (folder / "registration.json").write_text("{}")
    (folder / "lattice.toml").write_text('[[pattern]]\nzoom = 1.3\nkind = "lattice"\n'
                                         'distance_px = 4\ndot_px = 4\nseed = 1\n')
    code, out, err = run("demo", "--setup", "--out", folder, "--rig", rig_command, "--patterns",
                         folder / "lattice.toml")
    check(code == 1 and is_one_line(err) and "lattice" in err, f"a lattice: {err.strip()}")
    check(not (folder / "registration.json").exists(), "... leaves no registration either")
    code, out, err = run("demo", "--setup")
    check(code == 2 and is_one_line(err), f"usage: {err.strip()}")


def refined(setup, folder):
    """A second pair under the pattern that the first one asks for: against the first alone, and
    against a second under just another one."""
    folder.mkdir()
    rig = subprocess.Popen([SIM, "rig", "--seed", "1", "--phantom-seed", "1000"], text=True,
                           stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def ask(**request):
        print(json.dumps(request), file=rig.stdin, flush=True)
        return json.loads(rig.stdout.readline())

    def reconstruct(name, pairs, *more):
        views = [w for pair in pairs for w in ("--left", pair / "left.png", "--right", pair / "right.png")]
        code, out, err = run("reconstruct", *views, "--calibration", setup / "seated.yaml", "--zoom",
                             "1.3", "--out", folder / f"{name}.ply", "--depth", folder / f"{name}.tiff",
                             "--step", "8", "--json", *more)
        check(code == 0, f"{name}: reconstructed ({err.strip()})")
        judged = ask(do="depth-error", zoom=1.3, pose=0, depth=str(folder / f"{name}.tiff"),
                     calibration=str(setup / "seated.yaml"))
        print(f"      {name}: {judged}", flush=True)
        return json.loads(out), judged

    first, pattern = setup / "pair", setup / "pattern.png"
    run("pattern", "--seed", "2", "--out", folder / "plain.png")
    result, single = reconstruct("single", [first], "--pattern", pattern, "--next-pattern",
                                 folder / "next.png")
    found = result["next_pattern"]["projector"]
    check(found["parts"] >= 40 and found["residual_px"] < 1, f"the projector is found: {found}")
    check(sum(result["next_pattern"]["needs"].values()) == 7500, "each square is judged")
    judged = {}
    for name, image in (("plain", "plain.png"), ("refined", "next.png")):
        ask(do="pair", zoom=1.3, pose=0, lamps="filtered", pattern=str(folder / image),
            out=str(folder / name))
        judged[name] = reconstruct(name, [first, folder / name])[1]
    rig.stdin.close()
    rig.wait()
    plain, better = judged["plain"], judged["refined"]
    check(better["coverage"] > single["coverage"] and better["median_mm"] < single["median_mm"]
          and better["share_over_1_mm_off_edges"] < single["share_over_1_mm_off_edges"],
          "a refined second pair: more is known, and better, than from the first alone")
    check(better["median_mm"] < plain["median_mm"] and better["coverage"] > plain["coverage"],
          "... and than with just another pattern")
    code, out, err = run("reconstruct", "--left", first / "left.png", "--right", first / "right.png",
                         "--calibration", setup / "seated.yaml", "--zoom", "1.3", "--out",
                         folder / "x.ply", "--pattern", folder / "plain.png", "--next-pattern",
                         folder / "x.png")
    check(code == 1 and is_one_line(err) and "is not what the left image shows" in err and
          not (folder / "x.png").exists() and not (folder / "x.ply").exists(),
          f"another pattern than was projected: {err.strip()}")
    code, out, err = run("reconstruct", "--left", first / "left.png", "--right", first / "right.png",
                         "--calibration", setup / "seated.yaml", "--zoom", "1.3", "--out",
                         folder / "x.ply", "--next-pattern", folder / "x.png")
    check(code == 2 and is_one_line(err) and "--pattern" in err, f"no pattern named: {err.strip()}")


def tracking(folder):
    """Paper B's experiment, its spiral a twentieth as large."""
    small = ["study", "--tracking", "--out", folder, "--scenes", "cavity_bone", "--pairs", "12"]
    code, out, err = run(*small, "--motions", "spiral:0.05", "--beam", "--beam-motions", "breathing:4",
                         "--beam-rate", "15", "--json")
    check(code == 0 and err == "", f"the tracking study ends well, silently ({code}: {err.strip()})")
    rows = {row["method"]: row for row in json.loads(out)["rows"]}
    check(sorted(rows) == ["direct", "orb", "paper"], "three methods on the same frames")
    check(all("refusal" not in row and row["frames"] >= 2 and row["lost"] == 0
              for row in rows.values()), f"each follows every frame ({rows})")
    ours, paper = rows["direct"], rows["paper"]
    check(ours["absolute_rms_um"] < 3, f"ours: {ours['absolute_rms_um']:.2f} um since the keyframe")
    check(ours["step_mean_um"] < paper["step_mean_um"] / 5,
          f"the paper's: {paper['step_mean_um']:.1f} um from frame to frame")
    now, ahead = json.loads(out)["beam"]
    check(now["lead_ms"] == 0 and 1 < ahead["lead_ms"] < 10 and now["stops"] == 0 == ahead["stops"],
          f"the beam, with poses for now and for when the robot has followed ({now}, {ahead})")
    check(now["on_share"] == ahead["on_share"] == 1 and
          ahead["rms_um"] < now["rms_um"] < now["uncompensated_rms_um"],
          f"... lands {ahead['rms_um']:.1f}, {now['rms_um']:.1f}, uncompensated "
          f"{now['uncompensated_rms_um']:.0f} um from its target")
    html = (folder / "report.html").read_text()
    check("<script" not in html and "Not for clinical use" in html and "327" in html,
          "the page runs nothing and quotes the paper")
    check(not re.search(r"\bnan\b|\binf\b", html), "no figure that is none")
    code, out, err = run(*small, "--motions", "wobble")
    check(code == 1 and is_one_line(err) and "wobble" in err, f"a motion unknown: {err.strip()}")


def disturbed(folder):
    """The site moves by 5 mm and 5 degrees behind something held before it; the calibration is the
    tracking study's."""
    before = (folder / "stereo.yaml").stat().st_mtime_ns
    small = ["study", "--tracking", "--disturbances", "--out", folder, "--scenes", "cavity_bone",
             "--pairs", "12", "--only", "occlusion", "--rate", "10", "--json"]
    code, out, err = run(*small)
    check(code == 0 and err == "", f"the study of disturbances ends well, silently ({code}: {err.strip()})")
    result = json.loads(out)
    row = result["rows"][0]
    check((folder / "stereo.yaml").stat().st_mtime_ns == before, "a calibration that stands there is used")
    check(row["silently_wrong"] == 0 == result["silently_wrong"], f"no frame is silently wrong: {row}")
    check(row["statuses"]["lost"] >= 5 and row["max_um"] < 50,
          "nothing is told of what is covered, and what is told is near the truth")
    check(row["frames_until_found"] == 0, "the first clear frame finds the site where it has moved to")
    html = (folder / "disturbances.html").read_text()
    check("<script" not in html and "Not for clinical use" in html and "occlusion" in html and
          not re.search(r"\bnan\b|\binf\b", html), "the page runs nothing and shows it")
    files = (folder / "disturbances.csv").read_bytes(), html
    code, out, err = run(*small)
    check(code == 0 and json.loads(out)["resumed"] == 1 and files ==
          ((folder / "disturbances.csv").read_bytes(), (folder / "disturbances.html").read_text()),
          "gone on with: nothing is made again, and it comes out the same")
    code, out, err = run("study", "--tracking", "--disturbances", "--out", folder, "--only", "rain")
    check(code == 2 and is_one_line(err) and "rain" in err, f"an unknown one: {err.strip()}")


with tempfile.TemporaryDirectory() as base:
    here = pathlib.Path(base)
    command = f"{sys.executable} {pathlib.Path(__file__).resolve()} rig {here / 'cache'} {SIM}"
    study(here / "study", command)
    setup(here / "setup", command)
    refined(here / "setup", here / "refined")
    refused_setups(here / "setup", command)
    tracking(here / "tracking")
    disturbed(here / "tracking")
sys.exit(1 if failures else 0)
