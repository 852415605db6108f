"""What the tests share: the programs, scenes, and how JSON is compared."""

import importlib.util
import json
import os
import pathlib
import subprocess

import numpy as np
import pytest

import saltus

SOURCE = pathlib.Path(os.environ["SALTUS_SOURCE"])
BIN = pathlib.Path(os.environ["SALTUS_BIN"])
TASKS = ["bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"]


def scene_of(task):
    return saltus.load_scene(SOURCE / "problems" / f"{task}.yaml")


def run_program(name, *flags):
    """The JSON that a program prints, whatever its verdict."""
    done = subprocess.run([BIN / name, *flags, "--json", "--progress=none"], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


def without(value, *keys):
    """Without what depends on the clock."""
    if isinstance(value, dict):
        return {key: without(child, *keys) for key, child in value.items() if key not in keys}
    if isinstance(value, list):
        return [without(child, *keys) for child in value]
    return value


def load_campaign(name):
    """The module of a script in tests/campaign."""
    spec = importlib.util.spec_from_file_location(name, SOURCE / "tests" / "campaign" / f"{name}.py")
    campaign = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(campaign)
    return campaign


def problem_of(flow=lambda t, x, u, p: [x[1], u[0]], guard=None, reset=None, initial=(0, 0), costs=None, **changes):
    """A problem of one mode with two states, and with a guard if one is given."""
    system = saltus.HybridSystem(
        states={"m": ["y", "v"]}, controls=["f"], parameters=["c"], flow={"m": flow},
        guards={"m": {"g": guard}} if guard else {}, resets={"m": {"g": reset}} if guard else {})
    given = costs if costs is not None else [saltus.residuals(lambda x: [x[0] - 1, x[1]])]
    return saltus.HybridProblem(system, mode="m", initial=initial, parameters=[0.0], duration=1.0, control=np.zeros((4, 1)),
                                costs=given, **changes)


@pytest.fixture
def two_balls():
    return scene_of("two_balls")


def make_generated_scenes(count, directory):
    """Scene files of discs in boxes and billiard breaks, one for each seed."""
    paths = []
    for seed in range(1, count + 1):
        kind, discs = ("break", 4 if seed % 2 else 7) if seed % 5 == 0 else ("gas", 2 + seed % 9)
        path = directory / f"scene_{seed}.yaml"
        text = subprocess.run(
            [BIN / "saltus_scene", f"--kind={kind}", f"--discs={discs}", f"--seed={seed}"],
            capture_output=True, text=True, check=True,
        ).stdout
        path.write_text(text, encoding="utf-8")
        paths.append(path)
    return paths
