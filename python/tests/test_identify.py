"""Parameters from recordings: what was put in comes out, as from the program, and what is wrong is refused."""

import math
import os
import pathlib
import signal
import threading

import numpy as np
import pytest
from conftest import run_program, without

import saltus

RADIUS, GRAVITY, RESTITUTION, SIGMA = 0.05, 9.81, 0.8, 1e-4


@pytest.fixture
def scene():
    """A ball above the ground; its restitution is wrong."""
    return saltus.Scene(
        name="drop", duration=1.0, steps=60, gravity=[0, -GRAVITY], optimize="none",
        bodies=[{"name": "ball", "radius": RADIUS, "mass": 0.2, "position": [0, 1]}],
        planes=[{"name": "floor", "point": [0, 0], "normal": [0, 1]}],
        contact={"restitution": 0.5}, objective={"terminal": []},
    )


def height_at(time):
    """Of the centre, dropped from 1 m: free fall and one impact."""
    impact = np.sqrt(2 * (1 - RADIUS) / GRAVITY)
    after = time - impact
    return np.where(
        time < impact,
        1 - 0.5 * GRAVITY * time**2,
        RADIUS + RESTITUTION * GRAVITY * impact * after - 0.5 * GRAVITY * after**2,
    )


@pytest.fixture
def recording():
    time = 0.02 * np.arange(40) + 0.007
    noise = np.where(np.arange(40) % 2, -SIGMA, SIGMA)
    position = np.stack([noise, height_at(time) + noise], axis=1)
    return {"time": time, "body": ["ball"] * 40, "position": position, "sigma": SIGMA}


def write_csv(recording, path):
    rows = zip(recording["time"], recording["body"], recording["position"])
    lines = [f"{time!r},{body},{x!r},{y!r},{recording['sigma']!r}" for time, body, (x, y) in rows]
    path.write_text("\n".join(["time,body,x,y,sigma", *lines]))
    return path


class TestFits:
    def test_the_restitution_of_a_ball(self, scene, recording):
        told = []
        fit = saltus.identify(scene, recording, status=told.append)
        assert fit["verdict"] == "fits" and fit["impacts"] == 1 and told
        # Samples after the impact leave the restitution to a few 1e-5.
        (item,) = fit["parameters"]
        assert abs(fit.estimates["restitution"] - RESTITUTION) < 4 * item["standard_error"] < 2e-3
        assert "restitution" in repr(fit) and "<table>" in fit._repr_html_()
        assert fit.reason == "" and fit.remarks == []

    def test_what_is_not_determined_has_no_value(self, scene, recording):
        fit = saltus.identify(scene, recording, ["restitution", "mass.ball"])
        assert np.isnan(fit.estimates["mass.ball"]) and "not determined" in repr(fit)

    def test_without_sigma_a_remark_tells_what_was_estimated(self, scene, recording):
        fit = saltus.identify(scene, {name: recording[name] for name in ("time", "body", "position")})
        assert fit.reason == "" and fit.remarks[0].startswith("sigma was estimated")

    def test_a_sigma_that_is_far_too_large_has_a_remark(self, scene, recording):
        fit = saltus.identify(scene, {**recording, "sigma": 100 * SIGMA})
        (remark,) = fit.remarks
        # Both coordinates are SIGMA off, and half of the lengths of two normal numbers are below 1.177.
        assert f"residuals are only {np.sqrt(2) / 117.7:.2g} times the stated sigma" in remark
        assert "check the unit of sigma" in remark
        few = {name: recording[name][::6] for name in ("time", "body", "position")}
        assert saltus.identify(scene, {**few, "sigma": 100 * SIGMA}).remarks == []  # so few may do so by chance

    def test_a_page(self, scene, recording, tmp_path):
        fit = saltus.identify(scene, recording, law="network:2")
        fit.save_page(tmp_path / "page")
        page = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
        for heading in ("Fits", "Law of impact", "Motions", "Scene"):
            assert f'"text":"{heading}"' in page
        assert saltus.load_result(tmp_path / "page" / "result.json").to_dict() == fit.to_dict()

    def test_a_law_of_impact(self, scene, recording):
        fit = saltus.identify(scene, recording, law="network:2")
        assert fit["law"]["impacts"] == 1
        point = fit["law"]["curve"][0]
        assert point["speed"] == pytest.approx(np.sqrt(2 * GRAVITY * (1 - RADIUS)), rel=1e-3)
        assert point["restitution"] == pytest.approx(RESTITUTION, abs=1e-3)

    @pytest.mark.parametrize("events", ["affine", "profile:2"])
    def test_event_functions(self, scene, recording, events):
        low = saltus.Scene({**scene.to_dict(), "planes": [{"name": "floor", "point": [0, -0.01], "normal": [0, 1]}]})
        fit = saltus.identify(low, recording, events=events)
        (impact,) = fit["events"]["impacts"]
        assert impact["plane"] == "floor" and impact["beyond_plane"] == pytest.approx(0.01, abs=1e-3)
        assert -impact["after"][1] / impact["before"][1] == pytest.approx(RESTITUTION, abs=1e-2)

    @pytest.mark.parametrize(
        "contact, options",
        [("event", {}), ("toi_velocity", {"loss": "cauchy", "loss_scale": 3, "segment": 0.5, "starts": 2}),
         ("event", {"known_start": True, "loss": "none"})],
    )
    def test_numbers_are_those_of_the_program(self, scene, recording, tmp_path, contact, options):
        printed, fit = self.printed_and_found(scene, [write_csv(recording, tmp_path / "a.csv")], contact, options, tmp_path)
        assert without(fit.to_dict(), "seconds") == without(printed, "seconds")
        # The same as arrays, but for names.
        arrays = saltus.identify(scene, recording, ["restitution", "gravity.y"], contact, threads=1, **options)
        assert arrays["parameters"] == fit["parameters"] and arrays["cost"] == fit["cost"]

    def test_several_recordings(self, scene, recording, tmp_path):
        """Ceres orders their starts by addresses, so that sums are rounded one way or another."""
        later = {key: value if key == "sigma" else value[3:] for key, value in recording.items()}
        np.savez(tmp_path / "later.npz", **later)
        paths = [write_csv(recording, tmp_path / "a.csv"), tmp_path / "later.npz"]
        printed, fit = self.printed_and_found(scene, paths, "event", {}, tmp_path)
        assert (fit["samples"], len(fit["segments"])) == (printed["samples"], 2) == (77, 2)
        arrays = saltus.identify(scene, [recording, later], "restitution,gravity.y")
        for found in (fit.estimates, arrays.estimates):
            assert found == pytest.approx({item["name"]: item["value"] for item in printed["parameters"]}, rel=1e-9)

    @staticmethod
    def printed_and_found(scene, paths, contact, options, directory):
        scene.save(directory / "drop.yaml")
        printed = run_program(
            "saltus_identify", f"--scene={directory / 'drop.yaml'}", f"--recording={','.join(map(str, paths))}",
            "--unknown=restitution,gravity.y", f"--contact={contact}", "--threads=1",
            *(f"--{key}={str(value).lower()}" for key, value in options.items()),
        )["fits"][0]
        return printed, saltus.identify(scene, paths, "restitution,gravity.y", contact, threads=1, **options)

    def test_is_saved_with_all_digits(self, scene, recording, tmp_path):
        fit = saltus.identify(scene, recording)
        fit.save(tmp_path / "fit.json")
        read = saltus.load_result(tmp_path / "fit.json")
        assert type(read) is saltus.Fit and read.to_dict() == fit.to_dict()

    def test_indices_of_bodies(self, scene, recording):
        by_index = {**recording, "body": np.zeros(40, dtype=np.int32)}
        assert saltus.identify(scene, by_index)["parameters"] == saltus.identify(scene, recording)["parameters"]


def bounces(times, restitution, friction, gravity, along):
    """The positions of a ball that falls from 1 m. Each impact takes friction * (1 + restitution) times its speed across the
    floor off that along it."""
    positions = []
    for rest in times:
        x, height, up, speed = 0.0, 1 - RADIUS, 0.0, along
        while True:
            fall = (up + np.sqrt(up**2 + 2 * gravity * height)) / gravity
            if fall > rest:
                break
            hit = gravity * fall - up
            x, height, up, rest = x + speed * fall, 0.0, restitution * hit, rest - fall
            speed -= friction * (1 + restitution) * hit
        positions.append([x + speed * rest, RADIUS + height + up * rest - gravity * rest**2 / 2])
    return np.array(positions)


class TestFewOrWrong:
    """Recordings without sigma, with errors of 2 mm."""

    @staticmethod
    def recording(seed, samples, outliers=0.0, duration=1.0, along=0.5, friction=0.0):
        rng = np.random.default_rng(seed)
        times = np.sort(rng.uniform(0, duration, samples))
        errors = 2e-3 * rng.normal(size=(samples, 2)) * np.where(rng.random(samples) < outliers, 30, 1)[:, None]
        return {"time": times, "body": ["ball"] * samples, "position": bounces(times, 0.7, friction, 10, along) + errors}

    @pytest.mark.parametrize("outliers", [0, 0.1, 0.25])
    def test_six_samples_are_not_judged(self, scene, outliers):
        """A wrong sample among them may pass for noise of a larger sigma, unless the loss states that there are none."""
        for seed in range(3):
            recording = self.recording(seed, 6, outliers)
            fit = saltus.identify(scene, recording, "restitution,gravity.y")
            assert fit["verdict"] == "not judged" and fit.reason.startswith("too few samples to judge")
            assert "state sigma, take more samples" in fit.reason
            assert all(item["standard_error"] is None for item in fit["parameters"])
        recording = self.recording(1, 6)
        assert saltus.identify(scene, recording, "restitution,gravity.y", loss="none")["verdict"] == "fits"

    def test_a_wrong_parameter_that_is_held_contradicts(self, scene):
        """The scene has another friction than the recording; freed, it is found."""
        scene = scene.replace(gravity=[0, -10], contact={"restitution": 0.6, "friction": 0.3})
        recording = self.recording(1, 60, along=3.0, friction=0.1)
        held = saltus.identify(scene, recording, "restitution")
        assert held["verdict"] == "contradicted"
        assert held.reason.endswith(", or let these be unknown too: friction (0.3)")
        free = saltus.identify(scene, recording, "restitution,friction")
        assert free["verdict"] == "fits"
        for item, truth in zip(free["parameters"], (0.7, 0.1)):
            assert abs(item["value"] - truth) < 4 * item["standard_error"]


class TestRefusals:
    @pytest.mark.parametrize(
        "change, error, words",
        [
            ({"position": np.zeros((40, 3))}, ValueError, r"recordings\[0\].*position: expected 40 x 2 numbers"),
            ({"position": 0.0}, ValueError, r"position: expected 40 x 2 numbers"),
            ({"position": np.full((40, 2), np.nan)}, ValueError, "position: found a number that is not finite"),
            ({"body": ["bal"] * 40}, ValueError, "body of row 0: found 'bal'"),
            ({"body": [1.5] * 40}, TypeError, r"recordings\[0\]\['body'\]: found dtype float64, expected names"),
            ({"time": ["now"] * 40}, TypeError, r"recordings\[0\]\['time'\]: found dtype <U3, expected real numbers"),
            ({"time": np.zeros(40)}, ValueError, "found 'ball' again at time 0"),
            ({"sigma": -1.0}, ValueError, "sigma of row 0: expected a number > 0"),
            ({"weight": 1.0}, ValueError, "found the array 'weight', expected time, body, position"),
        ],
    )
    def test_recordings(self, scene, recording, change, error, words):
        with pytest.raises(error, match=words):
            saltus.identify(scene, {**recording, **change})

    def test_no_recordings(self, scene, recording):
        with pytest.raises(TypeError, match=r"recordings\[1\]: found int, expected the path"):
            saltus.identify(scene, [recording, 3])
        with pytest.raises(TypeError, match=r"recordings\[0\]: found int, expected the path"):
            saltus.identify(scene, 3)
        with pytest.raises(ValueError, match="none.csv"):
            saltus.identify(scene, pathlib.Path("none.csv"))
        with pytest.raises(ValueError, match="recording"):
            saltus.identify(scene, [])

    @pytest.mark.parametrize(
        "wrong, words",
        [
            ({"unknown": "bounce"}, "unknown: found 'bounce', expected some of restitution"),
            ({"unknown": "restitution", "law": "network"}, "'restitution' beside a law"),
            ({"law": "network:x"}, "law: found 'network:x', expected network or impulse"),
            ({"events": "affine:2"}, "events: found 'affine:2', expected affine or profile"),
            ({"loss": "tukey"}, "loss: found 'tukey', expected none, huber or cauchy"),
            ({"loss_scale": 0}, "loss_scale"),
            ({"segment": -1}, "segment"),
            ({"starts": 0}, "starts"),
            ({"threads": -1}, "threads"),
            ({"contact": "evnt"}, "contact"),
            ({"contact": "direct", "law": "network"}, "direct"),
        ],
    )
    def test_options(self, scene, recording, wrong, words):
        with pytest.raises(ValueError, match=words):
            saltus.identify(scene, recording, **wrong)

    def test_contacts_in_python(self, scene, recording):
        with pytest.raises(TypeError, match="contact: found type, expected the name of a contact model"):
            saltus.identify(scene, recording, contact=saltus.ContactModel)

    def test_a_callback_that_fails(self, scene, recording):
        def fail(text):
            raise ZeroDivisionError("mine")

        with pytest.raises(ZeroDivisionError, match="mine") as caught:
            saltus.identify(scene, recording, status=fail)
        assert caught.value.fit["verdict"] == "interrupted"


def test_ctrl_c_keeps_what_it_has(scene):
    """A model without derivatives for Ceres to descend on, many samples and starts: it takes long."""
    time = np.linspace(0.01, 0.99, 2000)
    noise = np.random.default_rng(1).normal(size=(2000, 2))  # no motion fits
    recording = {"time": time, "body": ["ball"] * 2000, "position": noise, "sigma": SIGMA}
    timer = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt) as caught:
        saltus.identify(scene.replace(steps=30_000), recording, ["restitution", "gravity"], "ncp", starts=1000)
    timer.join()
    assert caught.value.fit["verdict"] == "interrupted"


class TestOutliersThatFollowEachOther:
    """A disc of radius 5 cm that slides at its first impact with the floor and loses its tangential speed at the second.

    Positions are those of free flight between impacts at times in closed form.
    """

    RESTITUTION, FRICTION, G = 0.8, 0.15, 9.81

    def scene(self, restitution=0.6, friction=0.1):
        return saltus.Scene({
            "name": "sliding_bounce",
            "optimize": "none",
            "duration": 1.5,
            "steps": 150,
            "gravity": [0, -self.G],
            "contact": {"restitution": restitution, "friction": friction},
            "planes": [{"name": "floor", "point": [0, 0], "normal": [0, 1]}],
            "bodies": [{"name": "disc", "radius": 0.05, "mass": 1, "position": [0, 0.8], "velocity": [1.6, 0.3]}],
            "objective": {"terminal": []},
        })

    def recording(self, count=80, seed=1, noise=1e-3, sigma=None, friction=FRICTION):
        time = np.linspace(0.01, 1.49, count)
        x, height, across, up = 0.02, 0.78, 1.7, 0.2  # height of the lowest point of the disc
        first = (up + math.sqrt(up**2 + 2 * self.G * height)) / self.G
        position, begin = np.empty((count, 2)), 0.0
        for end in (first, first + 2 * self.RESTITUTION * (self.G * first - up) / self.G, math.inf):
            t = time[(time >= begin) & (time < end)] - begin
            position[(time >= begin) & (time < end)] = np.stack(
                [x + across * t, 0.05 + height + up * t - self.G / 2 * t**2], axis=1
            )
            if math.isinf(end):
                break
            down = self.G * (end - begin) - up
            x, height, up = x + across * (end - begin), 0.0, self.RESTITUTION * down
            across = max(0.0, across - friction * (1 + self.RESTITUTION) * down)
            begin = end
        position += noise * np.random.default_rng(seed).standard_normal((count, 2))
        stated = {} if sigma is None else {"sigma": np.full(count, sigma)}
        return {"time": time, "body": np.zeros(count, int), "position": position, **stated}

    @pytest.mark.parametrize("segment", [0.49, 0.5, 0.51, 0.52])
    @pytest.mark.parametrize("start", [(0.6, 0.1), (0.8, 0.15)])
    def test_a_fit_does_not_end_where_friction_has_no_effect(self, segment, start):
        """Fits of the first samples of each segment bring friction to values at which every impact stops the disc."""
        fit = saltus.identify(self.scene(*start), self.recording(), "restitution,friction", segment=segment)
        assert fit.verdict == "fits"
        assert fit.estimates["restitution"] == pytest.approx(self.RESTITUTION, abs=0.008)
        assert fit.estimates["friction"] == pytest.approx(self.FRICTION, abs=0.006)
        assert not fit.outliers

    @pytest.mark.parametrize("sigma, verdict", [(1e-3, "contradicted"), (None, "not judged")])
    def test_a_wrong_restitution_that_is_held_does_not_fit(self, sigma, verdict):
        fit = saltus.identify(self.scene(0.6, 0.15), self.recording(sigma=sigma), "friction", segment=0.5)
        assert fit.verdict == verdict
        assert "outliers that follow each other" in fit.reason
        if sigma is not None:
            assert "let these be unknown too: restitution (0.6)" in fit.reason

    @pytest.mark.parametrize("count", [80, 40, 20])
    @pytest.mark.parametrize("sigma", [3e-4, 1e-4, 1e-5])
    def test_a_sigma_that_is_far_too_small_is_contradicted(self, count, sigma):
        recording = self.recording(count, noise=2e-3, sigma=sigma)
        fit = saltus.identify(self.scene(), recording, "restitution,friction")
        assert fit.verdict == "contradicted"
        assert "check sigma" in fit.reason
        assert 0.4 < fit.misfit * sigma / 2e-3 < 1.6

    @pytest.mark.parametrize("seed", range(8))
    def test_outliers_at_any_time_still_fit(self, seed):
        recording = self.recording(seed=seed, sigma=1e-3)
        random = np.random.default_rng(100 + seed)
        wrong = random.choice(80, size=5, replace=False)
        recording["position"][wrong] += random.uniform(-0.1, 0.1, (5, 2))
        fit = saltus.identify(self.scene(), recording, "restitution,friction")
        assert fit.verdict == "fits"
        assert fit.estimates["friction"] == pytest.approx(self.FRICTION, abs=0.006)


def test_a_ball_that_lies_on_the_ground_tells_nothing_of_gravity(scene):
    """Without gravity its motion is the same, and changes to one side only."""
    time = np.linspace(0, 0.98, 40)
    position = np.stack([0.3 * time + 1e-3 * np.random.default_rng(1).normal(size=40), np.full(40, RADIUS)], axis=1)
    fit = saltus.identify(scene, {"time": time, "body": ["ball"] * 40, "position": position}, "restitution,gravity.y", threads=1)
    assert fit.verdict == "not determined" and np.all(np.isnan(list(fit.estimates.values())))
    assert any("as well as those with" in remark and "one-sided" in remark for remark in fit["remarks"])
