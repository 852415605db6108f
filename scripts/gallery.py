#!/usr/bin/env python3
"""Makes the gallery from the programs: docs/gallery.md, its thumbnails, and the pictures of the README.

usage: scripts/gallery.py [--build=build/release] [--reports=DIR] [--check]

--reports: writes no pages, but the report with the replay of each entry, DIR/NAME.html.
--check: writes nothing; the exit code is 1 if the page lacks a scene or a system, or shows another input than its file.
Times are processor times of the machine on which this ran last, so that two runs differ in these only.
"""

import argparse
import contextlib
import io
import json
import math
import os
import pathlib
import re
import resource
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
PICTURES = ROOT / "data" / "pictures" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
COLOURS = ["#0969da", "#bc4c00", "#1a7f37", "#8250df", "#bf3989"]
STYLE = """<style>
.wall{stroke:#57606a;fill:none} .ghost{stroke:#8c959f;fill:none} .ghost-disc{fill:#8c959f;fill-opacity:.45}
.target{stroke:#57606a;fill:none} .paper{fill:#fff} text{font:FONTpx sans-serif;fill:#24292f}
@media (prefers-color-scheme: dark){.wall,.target{stroke:#adbac7} .paper{fill:#161b22} text{fill:#e6edf3}}
</style>"""


def scenes():
    """The scenes of discs with something to optimise."""
    return [path for path in sorted((ROOT / "problems").glob("*.yaml"))
            if path.stem not in ("bounce_once", "tossed_box", "ground_wall_spin")]


def systems():
    """The hybrid systems that are programs."""
    return sorted((ROOT / "problems" / "hybrid").glob("*.h"))


def excerpt(path):
    """Ten lines of input: those of a scene from its discs on, those of a system from its flow on."""
    lines = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".yaml":
        return [line for line in lines if not line.startswith(("#", "name:", "duration:", "steps:"))][:10]
    first = next((k for k, line in enumerate(lines) if re.search(r"void (Flow|Force)\(", line)), None)
    if first is None:  # a problem of a system that another header has
        first = next(k for k, line in enumerate(lines) if line.startswith("inline HybridProblem"))
        return lines[first : first + 10]
    cut = lines[first - 1 : first + 9]
    indent = min(len(line) - len(line.lstrip()) for line in cut if line.strip())
    return [line[indent:] for line in cut]


def summary(path):
    """The first sentences of a file, which are comments."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".yaml":
        comment = re.match(r"((?:#.*\n)+)", text)[1].replace("# ", "")
    else:
        comment = re.search(r"((?:^// .*\n)+)(?:inline HybridProblem|struct)", text, re.M)[1].replace("// ", "")
        problem = re.search(r"((?:^// .*\n)+)inline HybridProblem", text, re.M)
        if problem and problem[1].replace("// ", "") != comment:
            comment += problem[1].replace("// ", "")
    return re.sub(r"\s+", " ", comment).strip()


def command(path):
    if path.suffix == ".yaml":
        return ["saltus_solve", f"--scene=problems/{path.name}", "--contact=event"]
    return [path.stem]


def run(build, words):
    # An optimum that is none within the limits of the solver ends with exit code 1, with the same document.
    done = subprocess.run([build / "bin" / words[0], *words[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(map(str, words))}: {done.stderr}")
    return done.stdout


def document(build, words):
    """The first run of a program's document, with the processor time that it took, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    text = run(build, [*words, "--json", "--states", "--progress=none"])
    return {**json.loads(text)["runs"][0], "seconds": resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before}


def simplified(times, points, tolerance):
    """The indices of a polyline over time that keeps all points within a tolerance."""
    keep = [0]
    while keep[-1] < len(times) - 1:
        first, last = keep[-1], keep[-1] + 1

        def fits(end):
            for k in range(first + 1, end):
                s = (times[k] - times[first]) / (times[end] - times[first]) if times[end] > times[first] else 0
                if any(abs(points[first][j] + s * (points[end][j] - points[first][j]) - points[k][j]) > tolerance for j in (0, 1)):
                    return False
            return True

        while last + 1 < len(times) and fits(last + 1):
            last += 1
        keep.append(last)
    return keep


class Drawing:
    """An SVG picture of a rectangle of the plane, with y upwards."""

    def __init__(self, box, width):
        self.left, self.right, self.bottom, self.top = box
        self.scale = width / (self.right - self.left)
        self.width, self.height = width, round((self.top - self.bottom) * self.scale)
        self.parts = []

    def at(self, x, y):
        return f"{(x - self.left) * self.scale:.1f}", f"{(self.top - y) * self.scale:.1f}"

    def line(self, points, look):
        path = " ".join(",".join(self.at(*point)) for point in points)
        self.parts.append(f'<polyline points="{path}" {look}/>')

    def disc(self, x, y, radius, look, inside=""):
        cx, cy = self.at(x, y)
        self.parts.append(f'<circle cx="{cx}" cy="{cy}" r="{radius * self.scale:.1f}" {look}>{inside}</circle>')

    def svg(self, title, font=11):
        return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
                f'height="{self.height}"><title>{title}</title>{STYLE.replace("FONT", str(font))}'
                f'<rect class="paper" width="100%" height="100%"/>' + "\n".join(self.parts) + "</svg>\n")


def box_of(scene, motions, aspect):
    """The part of the plane that the motions need, and what is near of the walls."""
    xs, ys = [], []
    for motion in motions:
        for state in motion["exact_states"]:
            for body, (x, y, *_) in zip(scene["bodies"], state):
                xs += [x - body["radius"], x + body["radius"]]
                ys += [y - body["radius"], y + body["radius"]]
    for term in scene["objective"].get("terminal", []):
        if term.get("quantity") == "position" and "target" in term:
            xs.append(term["target"][0])
            ys.append(term["target"][1])
    margin = 0.08 * max(max(xs) - min(xs), max(ys) - min(ys))
    left, right, bottom, top = min(xs) - margin, max(xs) + margin, min(ys) - margin, max(ys) + margin
    wide = max(right - left, aspect * (top - bottom))
    high = max(top - bottom, (right - left) / aspect)
    x, y = (left + right) / 2, (bottom + top) / 2
    return x - wide / 2, x + wide / 2, y - high / 2, y + high / 2


def draw_walls(drawing, scene):
    reach = 2 * (drawing.right - drawing.left + drawing.top - drawing.bottom)
    for plane in scene.get("planes", []):
        (x, y), (nx, ny) = plane["point"], plane["normal"]
        length = math.hypot(nx, ny)
        dx, dy = -ny / length * reach, nx / length * reach
        drawing.line([(x - dx, y - dy), (x + dx, y + dy)], 'class="wall" stroke-width="2"')
    for segment in scene.get("segments", []):
        drawing.line([segment["from"], segment["to"]], 'class="wall" stroke-width="2"')
    for pocket in scene.get("pockets", []):
        drawing.disc(*pocket["position"], pocket["radius"], 'class="wall" stroke-width="2"')
    for body in scene["bodies"]:
        if body.get("fixed"):
            drawing.disc(*body["position"], body["radius"], 'class="wall" stroke-width="2"')
    size = 0.02 * (drawing.right - drawing.left)
    for term in scene["objective"].get("terminal", []):
        if term.get("quantity") == "position" and "target" in term:
            x, y = term["target"]
            for dx, dy in ((size, size), (size, -size)):
                drawing.line([(x - dx, y - dy), (x + dx, y + dy)], 'class="target" stroke-width="1.5"')


def path_of(motion, body):
    return [(state[body][0], state[body][1]) for state in motion["exact_states"]]


def draw_paths(drawing, scene, motion, tolerance, look):
    for b, body in enumerate(scene["bodies"]):
        if not body.get("fixed"):
            points = path_of(motion, b)
            kept = simplified(motion["exact_times"], points, tolerance)
            drawing.line([points[k] for k in kept], look(b))


def thumbnail_of_scene(scene, guess, found):
    drawing = Drawing(box_of(scene, [guess, found], 1.6), 320)
    tolerance = 0.2 / drawing.scale
    draw_walls(drawing, scene)
    draw_paths(drawing, scene, guess, tolerance, lambda b: 'class="ghost" stroke-dasharray="3 3"')
    draw_paths(drawing, scene, found, tolerance, lambda b: f'stroke="{COLOURS[b % 5]}" fill="none" stroke-width="1.5"')
    for b, body in enumerate(scene["bodies"]):
        if not body.get("fixed"):
            points = path_of(found, b)
            drawing.disc(*points[0], body["radius"], f'fill="{COLOURS[b % 5]}" fill-opacity=".25"')
            drawing.disc(*points[-1], body["radius"], f'fill="{COLOURS[b % 5]}"')
    return drawing.svg(f"{scene['name']}: the guess dashed, the optimum in colours, discs pale at the start")


def thumbnail_of_system(name, motion):
    """The first two numbers of the state over time, each in its own range, and the events."""
    drawing = Drawing((-0.02, 1.02, -0.05, 1.05 * 0.625), 320)
    times = motion["times"]
    end = times[-1] or 1
    for event in motion["events"]:
        x = event["time"] / end
        drawing.line([(x, 0), (x, 0.625)], 'class="ghost" stroke-dasharray="2 3"')
    for j in range(min(2, min(len(state) for state in motion["states"]))):
        values = [state[j] for state in motion["states"]]
        low, high = min(values), max(values)
        points = [(t / end, 0.6 * (v - low) / ((high - low) or 1) + 0.01) for t, v in zip(times, values)]
        kept = simplified([t / end for t in times], points, 0.002)
        drawing.line([points[k] for k in kept], f'stroke="{COLOURS[j]}" fill="none" stroke-width="1.5"')
    return drawing.svg(f"{name}: the first two states of the solution over time, with the events dotted")


def animation(scene, guess, found, seconds):
    """The guess in grey beside the optimum in colours, in a loop of some seconds; a pause at the end."""
    drawing = Drawing(box_of(scene, [guess, found], 1.9), 640)
    tolerance = 0.2 / drawing.scale
    draw_walls(drawing, scene)
    draw_paths(drawing, scene, guess, tolerance, lambda b: 'class="ghost" stroke-dasharray="4 4"')
    draw_paths(drawing, scene, found, tolerance, lambda b: f'stroke="{COLOURS[b % 5]}" fill="none" stroke-opacity=".6"')
    for motion, ghost in ((guess, True), (found, False)):
        times = motion["exact_times"]
        for b, body in enumerate(scene["bodies"]):
            if body.get("fixed"):
                continue
            points = path_of(motion, b)
            kept = simplified(times, points, tolerance)
            places = [drawing.at(*points[k]) for k in kept]
            key_times = ";".join([f"{0.85 * times[k] / times[-1]:.4f}" for k in kept] + ["1"])
            moves = "".join(
                f'<animate attributeName="{axis}" dur="{seconds}s" repeatCount="indefinite" keyTimes="{key_times}" '
                f'values="{";".join([place[j] for place in places] + [places[-1][j]])}"/>' for j, axis in enumerate(("cx", "cy")))
            drawing.disc(*points[0], body["radius"], 'class="ghost-disc"' if ghost else f'fill="{COLOURS[b % 5]}"', moves)
    drawing.parts.append('<text x="12" y="22">grey: initial guess &#160; colour: optimised shot &#160; cross: targets</text>')
    return drawing.svg(f"{scene['name']}: the initial guess in grey, the optimised shot in colour", 13)


def number(value):
    return "0" if value is not None and abs(value) < 1e-15 else f"{value:.5g}"


def entry(path, record):
    language = "yaml" if path.suffix == ".yaml" else "cpp"
    place = path.relative_to(ROOT).as_posix()
    certificate = f"; certificate: {record['certificate']}" if record["certificate"] else ""
    return "\n".join([
        f"### {path.stem}", "",
        f"![{record['alt']}](../data/pictures/gallery/{path.stem}.svg)", "",
        summary(path), "",
        f"```{language}", *excerpt(path), "```", "",
        f"`{' '.join(command(path))}` lowers the loss from {number(record['initial'])} to {number(record['final'])} in "
        f"{record['seconds']:.2f} s with `{record['solver']}`{certificate}. [Replay](gallery/{path.stem}.html), "
        f"[input](../{place}).", ""])


HEAD = """# Gallery

Every scene and every hybrid system that comes with saltus: a picture of its optimum, ten lines of its input, the command that optimises
it, and a replay. In the pictures of scenes the guess is dashed, the optimum has a colour for each disc, which is pale at the start, and
crosses are targets. In those of hybrid systems the first two states are drawn over time, each in its own range, with the events dotted.

`scripts/gallery.py` writes this page from the programs, and `scripts/docs.sh` makes the replays. Times are processor times of the whole program.
"""


def record_of(found, alt):
    certificate = found.get("certificate") or {}
    return {"initial": found["initial_loss"], "final": found["final_loss"], "seconds": found["seconds"], "solver": found["solver"],
            "certificate": certificate.get("verdict"), "alt": alt}


def draw_first_example():
    """Runs the first Python code of the README, which ends in a picture."""
    code = re.search(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)[1]
    os.chdir(ROOT)
    os.environ |= {"MPLBACKEND": "agg", "SOURCE_DATE_EPOCH": "0"}
    import matplotlib  # pylint: disable=import-outside-toplevel

    matplotlib.rcParams["svg.hashsalt"] = "saltus"  # the same file in each run
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code.replace('savefig("', f'savefig("{PICTURES.parent}/'), {})  # pylint: disable=exec-used


def write_pages(build):
    sys.path.insert(0, str(build / "python"))
    import saltus  # pylint: disable=import-outside-toplevel

    draw_first_example()
    PICTURES.mkdir(parents=True, exist_ok=True)
    parts = [HEAD, "## Scenes of discs\n"]
    for path in scenes():
        scene = saltus.load_scene(path).to_dict()
        found = document(build, command(path))
        guess = document(build, [*command(path), "--solver=none"])
        (PICTURES / f"{path.stem}.svg").write_text(thumbnail_of_scene(scene, guess, found), encoding="utf-8")
        parts.append(entry(path, record_of(found, f"Paths of the discs of {path.stem}: guess and optimum")))
        if path.stem == "bank_shot":
            (PICTURES.parent / "shot.svg").write_text(animation(scene, guess, found, 5), encoding="utf-8")
    parts.append("## Hybrid and mechanical systems\n")
    for path in systems():
        found = document(build, command(path))
        (PICTURES / f"{path.stem}.svg").write_text(thumbnail_of_system(path.stem, found["motion"]), encoding="utf-8")
        parts.append(entry(path, record_of(found, f"States of {path.stem} over time, with its events")))
    PAGE.write_text("\n".join(parts), encoding="utf-8")


def write_reports(build, folder):
    folder.mkdir(parents=True, exist_ok=True)
    for path in [*scenes(), *systems()]:
        with tempfile.TemporaryDirectory() as made:
            run(build, [*command(path), f"--output_dir={made}", "--progress=none"])
            shutil.move(pathlib.Path(made) / "report.html", folder / f"{path.stem}.html")  # the folders may be on two disks


def check():
    text = PAGE.read_text(encoding="utf-8")
    wrong = []
    for path in [*scenes(), *systems()]:
        if f"### {path.stem}\n" not in text or not (PICTURES / f"{path.stem}.svg").exists():
            wrong.append(f"{path.stem}: not in the gallery")
        elif "\n".join(excerpt(path)) not in text or summary(path) not in text:
            wrong.append(f"{path.stem}: the gallery shows another input")
    print("\n".join(wrong) or "the gallery has every scene and system")
    return 1 if wrong else 0


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build" / "release")
    parser.add_argument("--reports", type=pathlib.Path)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    if arguments.check:
        return check()
    build = arguments.build.resolve()
    if arguments.reports:
        write_reports(build, arguments.reports)
    else:
        write_pages(build)
    return 0


if __name__ == "__main__":
    sys.exit(main())
