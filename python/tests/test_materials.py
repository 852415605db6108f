"""Restitution and friction of each pair of materials."""

import numpy as np
import pytest

import saltus

E_STEEL, E_WOOD, MU_WOOD = 0.85, 0.4, 0.1


@pytest.fixture
def scene():
    """Two balls that meet the ground once, at 2 m/s and without gravity: of rubber on steel, and of wood on steel."""
    return saltus.Scene(
        name="materials", duration=0.5, steps=50, optimize="velocity", objective={
            "terminal": [{"body": "rubber_ball", "quantity": "velocity", "target": [0, 0]}]},
        bodies=[{"name": "rubber_ball", "radius": 0.1, "mass": 1, "position": [0, 0.5], "velocity": [1, -2], "material": "rubber"},
                {"name": "wooden_ball", "radius": 0.1, "mass": 2, "position": [5, 0.5], "velocity": [1, -2], "material": "wood"}],
        planes=[{"name": "ground", "point": [0, 0], "normal": [0, 1], "material": "steel"}],
        materials={"rubber": {"restitution": 0.9, "friction": 0.0}, "steel": {"restitution": 0.4, "friction": 0.1},
                   "wood": {"restitution": 0.6, "friction": 0.3}},
        pairs=[{"between": ["rubber", "steel"], "restitution": E_STEEL}],
        combine="min")


def test_scene_of_materials(scene):
    data = scene.to_dict()
    assert data["materials"]["wood"] == {"restitution": 0.6, "friction": 0.3}
    assert data["pairs"] == [{"between": ["rubber", "steel"], "restitution": E_STEEL}]
    assert data["combine"] == "min"
    assert saltus.Scene(data) == scene


def test_each_pair_has_its_rebound(scene):
    end = saltus.rollout(scene, "event").states[-1]
    assert end[0][2:4] == pytest.approx([1, 2 * E_STEEL], abs=1e-12)
    assert end[1][2:4] == pytest.approx([1 - MU_WOOD * (1 + E_WOOD) * 2, 2 * E_WOOD], abs=1e-12)


def test_wrong_materials_are_refused(scene):
    data = scene.to_dict()
    data["bodies"][0]["material"] = "ruber"
    with pytest.raises(saltus.SceneError, match="expected one of the scene's materials, rubber, steel, wood; did you mean rubber"):
        saltus.Scene(data)


def test_identify_names_pairs(scene):
    time = np.linspace(0.01, 0.49, 25)
    height = np.where(time < 0.2, 0.5 - 2 * time, 0.1 + 2 * E_STEEL * (time - 0.2))
    recording = {"time": time, "body": ["rubber_ball"] * 25, "position": np.stack([time, height], axis=1), "sigma": 1e-4}
    guess = scene.to_dict()
    guess["pairs"] = []
    fit = saltus.identify(saltus.Scene(guess), recording, unknown="restitution.rubber-steel", known_start=True)
    assert fit.estimates["restitution.rubber-steel"] == pytest.approx(E_STEEL, abs=1e-3)


def test_a_simulator_that_is_told_one_restitution_refuses(scene):
    with pytest.raises(ValueError, match="the scene has materials; black boxes are told one restitution and one friction"):
        saltus.audit(scene, simulate=lambda scene, initial, control, dt: initial)
