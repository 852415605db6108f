#!/usr/bin/env python3
"""What the programs print with --json, and the NPZ files that they write, are as schemas/*.json state.

usage: schemas_test.py --build=DIR        exit code 77 (skipped) without python3-jsonschema
"""

import argparse
import copy
import json
import pathlib
import subprocess
import sys
import tempfile

try:
    import jsonschema
except ImportError:
    print("python3-jsonschema is not installed")
    sys.exit(77)

SOURCE = pathlib.Path(__file__).resolve().parents[2]
ARRAYS = SOURCE / "schemas" / "solution_npz.json"
DROPS = "--scene=problems/drops/drops.yaml --recording=problems/drops/drop_4.csv"
RUNS = [
    ("audit", "saltus_audit --scene=problems/two_balls.yaml --contact=all --steps=120"),
    ("audit", "saltus_audit --scene=problems/ground_wall_spin.yaml --contact=event,direct,qcqp --width_sweep --steps=72"),
    ("audit", "saltus_audit --scene=problems/two_balls.yaml --contact=direct --steps=60 --surrogate=smoothed_zeroth"),
    ("audit", "saltus_audit --scene=problems/two_balls.yaml --contact=event --steps=60 "
              "--simulate='mine={build}/bin/saltus_simulate --contact=direct'"),
    ("audit", "saltus_audit --scene=problems/carrom_pot.yaml --contact=event"),
    ("solve", "saltus_solve --scene=problems/two_balls.yaml --contact=event,lcp --solver=all --states --steps=60 --iterations=30"),
    ("solve", "saltus_solve --scene=problems/two_balls.yaml --contact=all --solver=none --steps=60"),
    ("solve", "saltus_solve --scene=problems/two_balls.yaml --contact=direct --surrogate=smoothed_zeroth --steps=60 --iterations=3"),
    ("solve", "saltus_solve --scene=problems/back_spin.yaml --contact=event --solver=gd,ceres_phases --states --iterations=5"),
    ("solve", "saltus_solve --scene={bounded} --contact=event --solver=gd,ceres_phases,hmp --iterations=50"),
    ("solve", "saltus_solve --scene={limited} --contact=event --solver=ceres_phases --steps=60"),
    ("solve", "saltus_solve --scene=problems/two_balls.yaml --contact=event --solver=none --steps=60 --states --feedback "
              "--feedback_samples=20 --feedback_noise=state=0.1,force=0.1 --feedback_plant=lcp"),
    ("solve", "saltus_solve --scene=problems/ground_wall.yaml --contact=event --solver=gd --iterations=3 --steps=60 --feedback "
              "--feedback_samples=20"),
    ("problem", "two_balls --contact=event,direct --solver=gd --iterations=3"),
    ("hybrid", "slip_hopper --states"),
    ("hybrid", "controlled_ball --solver=all --iterations=20"),
    ("hybrid", "controlled_ball --solver=ceres_lm --iterations=20 --states --feedback --feedback_samples=20"),
    ("hybrid", "bouncing_ball --solver=none --feedback --feedback_samples=20"),
    ("hybrid", "bouncing_ball --audit --width_sweep --solver=none --steps=40 --set=y=1.3,v=0.4,g=9.81,e=0.8,duration=2"),
    ("hybrid", "bouncing_ball --solver=all --set=e=0.5"),
    ("identify", f"saltus_identify {DROPS} --unknown=restitution,gravity.y"),
    ("identify", f"saltus_identify {DROPS} --law=network:2"),
    ("identify", f"saltus_identify {DROPS} --unknown=gravity.y --events=affine"),
    ("identify", f"saltus_identify {DROPS} --contact=event,direct --unknown=restitution,mass.ball"),
]


# Solutions whose NPZ files together have every array.
SOLUTIONS = [
    "saltus_solve --scene=problems/two_balls.yaml --contact=event --solver=ceres_event,gd --steps=60 --iterations=30",
    "saltus_solve --scene={free} --contact=event --solver=gd --steps=60 --iterations=20 --learning_rate=10",
    "saltus_solve --scene=problems/two_balls.yaml --contact=direct --surrogate=smoothed_zeroth --steps=60 --iterations=3",
    "saltus_solve --scene=problems/back_spin.yaml --contact=event --solver=gd --iterations=30 --learning_rate=2",
    "saltus_solve --scene=problems/post_shot.yaml --contact=event --solver=ceres_lm --iterations=3",
]


def wrong_arrays(path, schema):
    """What an NPZ file has that its schema does not state, and the names of its arrays."""
    numpy = __import__("numpy")
    found, sizes, wrong = dict(numpy.load(path)), {}, []
    for name in set(schema["required"]) - set(found):
        wrong.append(f"no array {name}")
    for name, array in found.items():
        stated = schema["arrays"].get(name)
        kind = "text" if array.dtype.kind == "U" else str(array.dtype)
        if stated is None or stated["type"] != kind or len(stated["shape"]) != array.ndim:
            wrong.append(f"{name}: found {kind} {array.shape}, the schema has {stated}")
            continue
        for stated_size, size in zip(stated["shape"], array.shape):
            if sizes.setdefault(stated_size, size if isinstance(stated_size, str) else stated_size) != size:
                wrong.append(f"{name}: found {size} for {stated_size}, which is {sizes[stated_size]}")
    unknown = {size for array in schema["arrays"].values() for size in array["shape"] if isinstance(size, str)} ^ set(schema["symbols"])
    return wrong + [f"symbol {symbol} has no meaning or no use" for symbol in sorted(unknown)], set(found)


def check_solutions(build, scenes):
    schema, failed, seen = json.loads(ARRAYS.read_text(encoding="utf-8")), 0, set()
    for command in SOLUTIONS:
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(f"{build}/bin/{command.format(**scenes)} --output_dir={folder} --progress=none", shell=True, cwd=SOURCE, capture_output=True,
                           check=False)
            files = sorted(pathlib.Path(folder).glob("*.npz"))
            for path in files:
                wrong, names = wrong_arrays(path, schema)
                seen |= names
                failed += bool(wrong)
                print("".join(f"{command}: {path.name}: {text}\n" for text in wrong), end="")
            if not files:
                print(f"{command}: no NPZ file")
                failed += 1
    for name in sorted(set(schema["arrays"]) - seen):
        print(f"{ARRAYS.name}: no solution has the array {name}")
        failed += 1
    return failed


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, required=True)
    build = parser.parse_args().build.resolve()
    validators = {}
    for path in sorted((SOURCE / "schemas").glob("*.json")):
        if path == ARRAYS:
            continue
        schema = json.loads(path.read_text(encoding="utf-8"))
        jsonschema.Draft202012Validator.check_schema(schema)
        resolver = jsonschema.RefResolver(path.as_uri(), schema)  # one schema refers to others beside it
        validators[path.stem] = jsonschema.Draft202012Validator(schema, resolver=resolver)
    assert {kind for kind, _ in RUNS} == set(validators), "a schema without a run, or a run without a schema"
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        scene, scenes = (SOURCE / "problems" / "two_balls.yaml").read_text(encoding="utf-8"), {}
        for name, changed in [
            ("bounded", scene.replace("initial: [[3, 3]]", "initial: [[3, 3]], max: 3.5").replace("weight: 1.0", "hard: true")),
            ("limited", scene.replace("target: [0, 0], weight: 1.0", "min: [0, null], max: [0.5, 0.5]").replace(
                "effort: 0.1", "effort: 0.1\n  limits: [{body: striker, speed: {max: 2.6}}, {body: target, speed: {max: 2.5}, at: end}]")),
            ("free", scene.replace("effort: 0.1", "effort: 0.1\n  duration: {free: true, min: 0.5, max: 2, weight: 0.1}")),
        ]:
            scenes[name] = pathlib.Path(folder) / f"{name}.yaml"
            scenes[name].write_text(changed, encoding="utf-8")
        failed += check_solutions(build, scenes)
        for kind, command in RUNS:
            command = command.format(build=build, **scenes) + " --json --progress=none"
            done = subprocess.run(f"{build}/bin/{command}", shell=True, cwd=SOURCE, text=True, capture_output=True, check=False)
            if done.returncode not in (0, 1) or not done.stdout:
                print(f"{command}: exit code {done.returncode}\n{done.stderr}")
                failed += 1
                continue
            document = json.loads(done.stdout)
            errors = list(validators[kind].iter_errors(document))
            failed += bool(errors)
            for error in errors[:5]:
                print(f"{command}: {'/'.join(map(str, error.path))}: {error.message[:300]}")
            # A schema that takes anything would find nothing.
            wrong = copy.deepcopy(document)
            first = wrong.get("solve", wrong)
            first["no such key"] = 1
            if validators[kind].is_valid(wrong):
                print(f"{kind}: takes a document that is wrong")
                failed += 1
    print(f"{len(RUNS)} documents, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
