"""Sweeps: the rows of saltus_sweep, functions, executors, workers that die, figures."""

import csv
import io
import os
import signal
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import matplotlib.pyplot as plt
import numpy as np
import pytest
from conftest import BIN, SOURCE

import saltus
import saltus.plot

TWO_BALLS = SOURCE / "problems" / "two_balls.yaml"


def printed(*flags):
    command = [BIN / "saltus_sweep", f"--scene={TWO_BALLS}", "--progress=none", *flags]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return list(csv.DictReader(io.StringIO(done.stdout)))


def assert_same(table, rows, without=()):
    assert list(table) == list(rows[0])
    for name in table:
        if name in without:
            continue
        expected = [row[name] for row in rows]
        if table[name].dtype.kind == "f":
            np.testing.assert_array_equal(table[name], [float(text) if text else np.nan for text in expected])
        else:
            assert list(table[name]) == expected


def test_rows_are_those_of_the_program():
    grid = {"stiffness": [1e3, 1e4], "steps": [60, 120]}
    rows = printed("--sweep=stiffness=1e3,1e4;steps=60,120", "--contact=compliant_warp,direct", "--solver=none")
    assert_same(saltus.sweep(TWO_BALLS, grid, contact=["compliant_warp", "direct"]), rows)
    rows = printed("--sweep=(contact,solver)=(direct_toi,gd),(event,ceres_lm); striker.mass=1,2", "--iterations=5")
    pairs = {("contact", "solver"): [("direct_toi", "gd"), ("event", "ceres_lm")], "striker.mass": [1, 2]}
    assert_same(saltus.sweep(TWO_BALLS, pairs, iterations=5), rows, ["seconds"])


def test_impossible_points_are_rows():
    table = saltus.sweep(TWO_BALLS, {"restitution": [0.5, 1.5]}, contact="direct")
    assert list(table["status"]) == ["done", "failed"]
    assert "restitution" in table["reason"][1] and np.isnan(table["loss"][1])


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"grid": {"colour": [1]}}, "colour"),
        ({"grid": {"seed": [1]}}, "takes the place of the scene"),
        ({"grid": {"steps": [1]}, "contact": "none"}, "contact"),
        ({"grid": {"steps": [1]}, "solver": "none"}, "solver"),
        ({"grid": {"steps": [1]}, "iterations": -1}, "iterations"),
    ],
)
def test_wrong_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        saltus.sweep(TWO_BALLS, **arguments)


def area(width, height):
    if width > 2:
        raise ValueError("too wide")
    return {"area": width * height, "shape": "square" if width == height else "oblong"}


def test_functions_are_called_with_the_options():
    with ThreadPoolExecutor(2) as pool:
        for client in (None, pool):
            table = saltus.sweep(area, {"width": [1, 2, 3], "height": [1, 2]}, client)
            assert list(table) == ["width", "height", "area", "shape", "reason", "status"]
            np.testing.assert_array_equal(table["area"], [1, 2, 2, 4, np.nan, np.nan])
            assert list(table["shape"]) == ["square", "oblong", "oblong", "square", "", ""]
            assert list(table["reason"][4:]) == ["ValueError: too wide"] * 2


@pytest.mark.parametrize(
    "result, error",
    [
        ({"width": 7.0}, "ValueError: the function returned 'width', which is an option of the grid; return it by another name"),
        ({"status": 7.0}, "ValueError: the function returned 'status', which is a column that every table has; return it by "
                          "another name"),
        (7.0, "TypeError: the function returned float, expected a dict of numbers and text by their names"),
        (None, "TypeError: the function returned NoneType, expected a dict of numbers and text by their names"),
        ({"path": [1.0, 2.0]}, "TypeError: the function returned list as 'path', expected a number, text or None"),
        ({"point": 1j}, "TypeError: the function returned complex as 'point', expected a number, text or None"),
        ({"area": 10**400}, "ValueError: the number 'area' that the function returned is beyond the largest float, 1.8e+308"),
    ],
)
def test_what_a_function_may_not_return(result, error):
    table = saltus.sweep(lambda width: result if width > 1 else {"area": np.float32(2), "wide": np.bool_(False)}, {"width": [1, 2]})
    assert list(table) == ["width", "area", "wide", "reason", "status"]
    np.testing.assert_array_equal(table["width"], [1, 2])
    np.testing.assert_array_equal(table["area"], [2, np.nan])
    assert list(table["reason"]) == ["", error]


@pytest.mark.parametrize(
    "arguments, error, message",
    [
        ({"grid": "width=1,2"}, ValueError, "grid: found text"),
        ({"grid": [1, 2]}, TypeError, "grid: found list, expected a dict of the values of each option"),
        ({"grid": {}}, ValueError, "grid: found no option, expected a dict of the values of each option"),
        ({"grid": {"width": 1.0}}, TypeError, "grid: found 1.0 for the option 'width', expected a list of its values"),
        ({"grid": {"width": "12"}}, TypeError, "grid: found '12' for the option 'width', expected a list of its values"),
        ({"grid": {1: [2]}}, TypeError, "grid: found the option 1, expected a name or a tuple of names"),
        ({"grid": {("width", "height"): [1, 2]}}, TypeError, "for the options width, height, expected a list of tuples"),
        ({"grid": {"width": [1], "height": [1, 10**400]}}, ValueError, "grid: a value of 'height' is beyond the largest float"),
        ({"grid": {("width", "height"): [(1, 2, 3)]}}, ValueError,
         r"grid: found \(1, 2, 3\) for the options width, height, expected 2 values"),
        ({"grid": {("width", "height"): [(1, 2)], "width": [3]}}, ValueError, "grid: found 'width' twice, expected each option once"),
        ({"grid": {"width": [1], "status": [2]}}, ValueError, "grid: found 'status', which is a column that every table has"),
        ({"grid": {"width": [1]}}, TypeError, r"missing a required argument: 'height'; the function takes \(width, height\)"),
        ({"grid": {("width", "depth"): [(1, 2)]}}, TypeError, "the grid has width, depth"),
        ({"contact": "direct"}, ValueError, "contact: expected with a scene only; give it to the function as an option"),
        ({"point_seconds": 1.0}, ValueError, "point_seconds: expected with a scene only"),
        ({"iterations": 5}, ValueError, "iterations: expected with a scene only"),
    ],
)
def test_functions_take_options_of_the_grid_alone(arguments, error, message):
    with pytest.raises(error, match=message):
        saltus.sweep(area, **{"grid": {"width": [1, 2], "height": [1]}, **arguments})


def test_the_number_of_threads_is_at_least_zero():
    with pytest.raises(ValueError, match=r"threads: found -1, expected at least 0 \(0 is one per core\)"):
        saltus.sweep(area, {"width": [1], "height": [2]}, threads=-1)
    with pytest.raises(TypeError, match="threads: found float, expected a whole number"):
        saltus.sweep(TWO_BALLS, {"steps": [60]}, threads=1.5)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_of_a_point_ends_the_sweep(error):
    done = []

    def interrupted(x):
        if x == 1:
            raise error
        done.append(x)
        return {"y": x}

    with pytest.raises(error) as caught:
        saltus.sweep(interrupted, {"x": list(range(100))}, threads=1)
    assert 0 in done
    table = caught.value.table
    assert list(table) == ["x", "y", "reason", "status"] and table["x"].tolist() == table["y"].tolist() == [0]


def test_points_behind_the_limit_of_time_are_failed():
    begun, go_on = threading.Event(), threading.Event()

    def waits(x):
        if x == 1:
            begun.set()
            go_on.wait()
        return {"y": x}

    threading.Thread(target=lambda: (begun.wait(), time.sleep(0.2), go_on.set())).start()
    table = saltus.sweep(waits, {"x": [0, 1, 2]}, threads=1, seconds=0.1)
    assert table["status"].tolist() == ["done", "failed", "failed"]
    assert "not computed within 0.1 s, the limit of the sweep; raise seconds" in table["reason"][2]
    with pytest.raises(ValueError, match="seconds: found -1, expected a finite number of at least 0"):
        saltus.sweep(area, {"width": [1], "height": [1]}, seconds=-1)


def test_a_scene_ends_at_the_limit_of_time():
    begin = time.monotonic()
    table = saltus.sweep(TWO_BALLS, {"steps": [200_000, 200_001]}, contact="ncp", solver="gd", seconds=0.5, threads=1,
                         iterations=1_000_000)
    assert table["status"].tolist() == ["failed", "failed"] and time.monotonic() - begin < 60  # they would take days


def test_a_grid_without_points_has_its_columns():
    table = saltus.sweep(area, {"width": [], "height": [1.0]})
    assert list(table) == ["width", "height", "reason", "status"]
    assert all(column.shape == (0,) for column in table.values())


def slow_square(x, folder):
    """Kills its worker, once."""
    mark = os.path.join(folder, "killed")
    if x == 7:
        try:
            os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return {"square": x * x}
        os.kill(os.getpid(), signal.SIGKILL)
    return {"square": x * x}


def test_dask_computes_all_rows_though_a_worker_is_killed(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(SOURCE / "python" / "tests")]))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster, distributed.Client(cluster) as client:
        table = saltus.sweep(slow_square, {"x": list(range(20)), "folder": [str(tmp_path)]}, client)
        assert (tmp_path / "killed").exists()
        np.testing.assert_array_equal(table["square"], np.arange(20.0) ** 2)
        grid = {"stiffness": list(np.geomspace(1e2, 1e4, 10)), "steps": [30, 60]}
        there = saltus.sweep(TWO_BALLS, grid, client, contact=["compliant_warp"])
        here = saltus.sweep(TWO_BALLS, grid, contact=["compliant_warp"])
        for name in here:
            np.testing.assert_array_equal(there[name], here[name])


def test_figures():
    x, y = (each.ravel() for each in np.meshgrid([1e2, 1e3, 1e4], np.linspace(0, 1, 50), indexing="ij"))
    values = y.copy()
    values[-1] = 1e6  # one extreme point
    status = np.full(150, "done")
    status[0] = "failed"
    table = {"stiffness": x, "damping": y, "loss": values, "flat": np.ones(150), "reason": np.full(150, ""), "status": status}
    figure = saltus.plot.heat_maps(table, "stiffness", "damping")
    maps = [ax for ax in figure.axes if ax.get_title()]
    assert [ax.get_title() for ax in maps] == ["loss"]
    (mesh,) = maps[0].collections
    assert mesh.norm.vmax < 1.1 and maps[0].get_xscale() == "log" and maps[0].get_yscale() == "linear"
    assert mesh.get_array().mask.sum() == 1
    drawn = mesh.get_array().reshape(50, 3)
    assert drawn[10, 1] == pytest.approx(values[60])
    assert saltus.plot.heat_maps(table, "stiffness", "damping", ["flat"]).axes[0].get_title() == "flat"
    with pytest.raises(ValueError, match="at least two values"):
        saltus.plot.heat_maps(table, "flat", "damping")
    for draw in (saltus.plot.heat_maps, saltus.plot.curves):
        with pytest.raises(ValueError, match="x: found 'stifness', expected a column of the table: stiffness, damping, loss"):
            draw(table, "stifness", "damping")
        with pytest.raises(ValueError, match="y: found the column 'status' of text, expected one of numbers"):
            draw(table, "stiffness", "status")
    with pytest.raises(ValueError, match="columns: found 'lost', expected a column of the table"):
        saltus.plot.heat_maps(table, "stiffness", "damping", ["lost"])
    assert saltus.plot.heat_maps(table, "stiffness", "damping", "flat").axes[0].get_title() == "flat"
    (line,) = saltus.plot.curves(table, "stiffness", "loss", reduce=np.max).lines
    np.testing.assert_allclose(line.get_ydata(), [1, 1, 1e6])
    plt.close("all")
