#!/usr/bin/env python3
# Drives replays in headless Chromium.
import json
import math
import os

from pages import BALL, BOX, Pages, main, run


STRANGE = "<b>\"it's\" & ü 日本</b></script>"
EDGES = """
name: edges
duration: 1.5
steps: 150
gravity: [0, -9.8]
bodies:
  - {name: ball, radius: 0.1, mass: 1, position: [0, 1.6], velocity: [0.3, 0]}
  - {name: other, radius: 0.08, mass: 0.5, position: [-0.6, 1.2], velocity: [0.2, 1]}
segments:
  - {name: gate, from: [-0.4, 0.9], to: [0.2, 0.75]}
polygons:
  - {name: frame, points: [[-1.2, -0.6], [1.2, -0.6], [1.2, 1.8], [0, 2.2], [-1.2, 1.8]], solid: outside}
  - {name: wedge, points: [[0.5, -0.2], [0.9, -0.2], [0.7, 0.3]], solid: inside}
arcs:
  - {name: bowl, center: [-0.2, 0.3], radius: 0.7, from: 3.3, to: 6.0}
contact: {restitution: 0.8, friction: 0}
objective: {terminal: [{body: ball, quantity: position, target: [0, 0], weight: 1}]}
optimize: velocity
"""


class Replays(Pages):
    # From here on a motion that plays goes on by a frame of so many milliseconds where the test says so, however long
    # Chromium takes for what comes in between.
    def stop_clock(self):
        self.js("""
            window.frames_ = [];
            window.requestAnimationFrame = (frame) => window.frames_.push(frame);""")

    def let_pass(self, milliseconds):
        self.js("""
            const now = saltusReplays[0].last + arguments[0];
            for (const frame of window.frames_.splice(0)) frame(now);""", milliseconds)

    # The ball falls 1 m in 1/2 s, and rises with half its speed.
    def exact_ball(self, time):
        if time < 0.5:
            return [3 * time, 1.25 - 4 * time * time, 3, -8 * time]
        since = time - 0.5
        return [3 * time, 0.25 + 2 * since - 4 * since * since, 3, 2 - 8 * since]

    def test_replay_shows_the_exact_states(self):
        scene = self.write("ball.yaml", BALL.replace("FRICTION", "0"))
        folder, done = self.solve(scene, "--contact=event,direct", "--solver=none")
        self.assertEqual(done.stdout.splitlines()[-1], os.path.join(folder, "report.html"))
        page = os.path.join(self.folder, "ball.html")
        run("saltus_replay", os.path.join(folder, "falls_event_none.npz"), f"--output={page}")
        self.open(page)
        size = 3.0
        button = {name: f"document.querySelector('button[aria-label=\"{name}\"]').click()" for name in
                  ("next impact", "previous impact", "one step on", "play", "pause", "to the start")}
        self.js(button["next impact"])
        time = self.js("return saltusReplays[0].time")
        self.assertAlmostEqual(time, 0.5, delta=1e-12)
        for (motion, _), values in self.shown_values().items():
            for shown, exact in zip(values[:2], self.exact_ball(0.5)):
                self.assertAlmostEqual(shown, exact, delta=1e-6 * size, msg=motion)
        # In between the nodes too, by the slider.
        for time in (0.0, 0.123, 0.31, 0.499, 0.501, 0.77, 1.0):
            self.js("""const slider = document.querySelector('.replay input[type=range]');
                       slider.value = arguments[0]; slider.dispatchEvent(new Event('input'));""", time)
            values = self.shown_values()[("event", "ball")]
            for shown, exact in zip(values, self.exact_ball(time)):
                self.assertAlmostEqual(shown, exact, delta=2e-6 * size, msg=f"at {time} s")
        self.js(button["previous impact"])
        self.assertAlmostEqual(self.js("return saltusReplays[0].time"), 0.5, delta=1e-12)
        self.js(button["to the start"])
        for values in self.shown_values().values():  # without the digits that the page does not store
            self.assertEqual(values, [0, 1.25, 3, 0])
        self.js(button["one step on"])
        self.assertAlmostEqual(self.js("return saltusReplays[0].time"), 1 / 240, delta=1e-12)
        self.assert_quiet()

    def test_replay_plays_and_obeys_keys(self):
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys
        scene = self.write("plays.yaml", BALL.replace("FRICTION", "0.2"))
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        self.stop_clock()
        self.js("document.querySelector('.replay canvas').focus(); saltusReplays[0].speed.value = 0.25")
        keys = lambda *pressed: ActionChains(self.browser).send_keys(*pressed).perform()  # noqa: E731
        keys(" ")
        for _ in range(2):
            self.let_pass(40)
        self.assertTrue(self.js("return saltusReplays[0].playing"))
        self.assertAlmostEqual(self.js("return saltusReplays[0].time"), 0.02, delta=1e-9)
        keys(" ")
        self.assertFalse(self.js("return saltusReplays[0].playing"))
        self.let_pass(40)
        time = self.js("return saltusReplays[0].time")
        self.assertAlmostEqual(time, 0.02, delta=1e-9)
        keys(Keys.ARROW_RIGHT)
        self.assertAlmostEqual(self.js("return saltusReplays[0].time"), min(time + 1 / 240, 1), delta=1e-9)
        keys(Keys.HOME)
        self.assertEqual(self.js("return saltusReplays[0].time"), 0)
        keys(Keys.END)
        self.assertEqual(self.js("return saltusReplays[0].time"), 1)
        self.assert_quiet()

    # Fingers on a phone: the button, the slider, a tap on the picture, a drag across it; one upwards scrolls the page.
    def test_replay_obeys_fingers(self):
        from selenium.common.exceptions import TimeoutException
        from selenium.webdriver.support.ui import WebDriverWait
        scene = self.write("fingers.yaml", BALL.replace("FRICTION", "0"))
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        path = os.path.join(folder, "report.html")
        self.open(path, width=400)
        self.browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        self.addCleanup(self.browser.execute_cdp_cmd, "Emulation.setTouchEmulationEnabled", {"enabled": False})
        self.browser.get("file://" + path)
        self.stop_clock()

        def touch(kind, *points):
            self.browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [
                {"x": x, "y": y} for x, y in points]})

        # From a place in a part of the page, both in shares of its size, along shares of the canvas' width.
        def move(selector, across, down=0.5, along=()):
            x, y, width = self.js("""
                const part = document.querySelector(arguments[0]);
                part.scrollIntoView({block: 'center', behavior: 'instant'});
                const {left, top, width, height} = part.getBoundingClientRect();
                return [left + arguments[1] * width, top + arguments[2] * height,
                        document.querySelector('.replay canvas').clientWidth];""", selector, across, down)
            touch("touchStart", (x, y))
            for right, up in along:
                touch("touchMove", (x + right * width, y - up * width))
            touch("touchEnd")

        # Where the machine is busy, a finger may rest so long that it is taken for another gesture, of which none has
        # the same effect: it comes again.
        def moves(reached, *gesture, before=""):
            for _ in range(5):
                self.js(before)
                move(*gesture)
                try:
                    return WebDriverWait(self.browser, 5).until(lambda _: self.js("return " + reached))
                except TimeoutException:
                    pass
            self.fail(f"not reached: {reached}")

        playing, time = "saltusReplays[0].playing", "saltusReplays[0].time"
        moves(playing, ".buttons button", 0.5)
        moves("!" + playing, ".replay canvas", 0.5)
        moves(f"Math.abs({time} - 0.75) < 0.05", ".line input", 0.75)
        moves(f"Math.abs({time} - 0.7) < 0.02", ".replay canvas", 0.25, 0.5, [(0.1, 0), (0.3, 0), (0.5, 0)],
              before="saltusReplays[0].seek(0.2)")
        self.assertFalse(self.js("return " + playing))
        moves("window.scrollY > window.before", ".replay canvas", 0.5, 0.5, [(0, 0.05 * part) for part in range(1, 9)],
              before="""document.querySelector('.replay canvas').scrollIntoView({block: 'center', behavior: 'instant'});
                        window.before = window.scrollY;""")
        self.assertAlmostEqual(self.js("return " + time), 0.7, delta=0.02)
        self.assertFalse(self.js("return " + playing))
        self.assert_quiet()

    # Something is drawn, it changes as time passes, and paper gets stills.
    def test_canvas_is_drawn_and_printed(self):
        scene = self.write("box.yaml", BOX)
        folder, _ = self.solve(scene, "--contact=event,direct_toi", "--solver=gd", "--iterations=5")
        self.open(os.path.join(folder, "report.html"))
        picture = "saltusReplays[0].seek(arguments[0]); return document.querySelector('.replay canvas').toDataURL()"
        pictures = {self.js(picture, time) for time in (0, 0.5, 1.0)}
        self.assertEqual(len(pictures), 3)
        self.js("saltusReplays[0].options.apart = true; saltusReplays[0].redraw()")
        self.assertNotIn(self.js(picture, 1.0), pictures)
        self.js("window.dispatchEvent(new Event('beforeprint'))")
        self.assertEqual(self.js("return document.querySelectorAll('.stills img').length"), 6)
        self.assert_quiet()

    # Before it starts, the whole path is there in the colour of the disc; x and y and speed are plotted.
    def test_whole_paths_are_drawn(self):
        scene = self.write("ball.yaml", BALL.replace("FRICTION", "0"))
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        at_path = """
            const [replay] = saltusReplays, {view} = replay, {canvas} = view, ratio = canvas.width / canvas.clientWidth;
            Object.assign(replay.options, {paths: arguments[0], names: false});
            replay.seek(0);
            replay.redraw();
            const x = Math.round(ratio * view.toX(3 * 0.4)), y = Math.round(ratio * view.toY(1.25 - 4 * 0.4 ** 2));
            const {data} = canvas.getContext('2d').getImageData(x - 3, y - 3, 7, 7);
            const inked = [...data].map((_, i) => i).filter((i) => i % 4 === 3 && data[i] > 60);
            return inked.map((i) => [data[i - 3], data[i - 2], data[i - 1]]);"""
        self.assertEqual(self.js(at_path, False), [])
        inked = self.js(at_path, True)
        self.assertGreater(len(inked), 2)
        for red, green, blue in inked:  # #2f81f7, thin and half transparent
            self.assertTrue(red < green < blue, (red, green, blue))
        labels = self.js("return [...document.querySelectorAll('.plot text')].map((text) => text.textContent)")
        self.assertTrue({"x (m)", "y (m)", "speed (m/s)"} <= set(labels), labels)

    def test_walls_that_nothing_touches_are_shown(self):
        scene = self.write("wide.yaml", BOX.replace("velocity: [2, 1.3]", "velocity: [0, 0]").replace("velocity: [-1, 0.7]", "velocity: [0, 0]"))
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        self.assertEqual(self.js("const {bounds} = saltusReplays[0].view; return [bounds.left < -1, bounds.right > 1, bounds.bottom < -1, bounds.top > 1]"),
                         [True] * 4)

    # Discs that are too many for a path each: there is a disc where one is, and about their areas are covered.
    def test_many_discs_are_drawn(self):
        scene = self.write("many.yaml", run("saltus_scene", "--kind=gas", "--discs=100", "--seed=1").stdout)
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        drawn, discs, covered, area = self.js("""
            const [replay] = saltusReplays, {view, discs, options} = replay, {canvas} = view, state = new Float64Array(400);
            Object.assign(options, {touches: false, names: false, trails: false, paths: false});
            replay.walls.length = replay.targets.length = 0;
            replay.seek(0.6 * replay.duration);
            replay.motions[0].stateAt(replay.time, state);
            const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
            const alphaAt = (x, y) => data[4 * (canvas.width * Math.floor(view.toY(y)) + Math.floor(view.toX(x))) + 3];
            const covered = data.filter((value, i) => i % 4 === 3 && value > 0).length;
            const area = discs.reduce((sum, {radius}) => sum + Math.PI * (view.scale * radius + 0.5) ** 2, 0);
            return [discs.filter((_, i) => alphaAt(state[4 * i], state[4 * i + 1]) > 0).length, discs.length, covered, area];""")
        self.assertEqual((drawn, discs), (100, 100))
        self.assertAlmostEqual(covered / area, 1, delta=0.2)
        self.assert_quiet()

    # Walls that end: what is solid is filled, and where discs touch them is a disc's radius away.
    def test_walls_that_end_are_drawn(self):
        scene = self.write("edges.yaml", EDGES)
        folder, done = self.solve(scene, "--contact=event,direct", "--solver=none", "--states", "--json")
        page = os.path.join(self.folder, "edges.html")
        states = self.write("edges.json", done.stdout)
        run("saltus_replay", states, f"--output={page}")
        for path in (os.path.join(folder, "report.html"), page):
            self.open(path)
            places = [([0.7, 0.0], True), ([1.19, 2.1], True), ([0.0, -0.1], False), ([0.0, 2.0], False)]
            colours = self.js("""
                saltusReplays[0].redraw();
                const {view} = saltusReplays[0], {canvas} = view, ratio = canvas.width / canvas.clientWidth;
                const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
                return arguments[0].map(([x, y]) => {
                  const at = 4 * (canvas.width * Math.round(ratio * view.toY(y)) + Math.round(ratio * view.toX(x)));
                  return [...data.slice(at, at + 4)];
                })""", [place for place, _ in places])
            for (place, solid), colour in zip(places, colours):
                self.assertEqual(colour, [216, 222, 228, 255] if solid else [0, 0, 0, 0], place)
            bowl = self.js("return saltusReplays[0].outlines.find(({name}) => name === 'bowl').points")
            for i, (x, y) in enumerate(bowl):
                angle = 3.3 + 2.7 * i / (len(bowl) - 1)
                self.assertAlmostEqual(x, -0.2 + 0.7 * math.cos(angle), delta=1e-12)
                self.assertAlmostEqual(y, 0.3 + 0.7 * math.sin(angle), delta=1e-12)
            touches = self.js("""
                const replay = saltusReplays[0], {view} = replay, state = new Float64Array(8), motion = replay.motions[0];
                return motion.touches.filter((touch) => touch.wall).map(({a, b, begin}) => {
                  motion.stateAt(begin, state);
                  const [x, y] = view.contactWith(replay.walls[b], state[4 * a], state[4 * a + 1]);
                  return [replay.walls[b].name, Math.hypot(x - state[4 * a], y - state[4 * a + 1]) - [0.1, 0.08][a]];
                })""")
            met = {name.split(".")[0] for name, _ in touches}
            self.assertTrue({"gate", "frame", "bowl"} <= met, met)
            for name, gap in touches:
                self.assertAlmostEqual(gap, 0, delta=2e-6, msg=name)

    # A disc that nothing touches turns at a constant speed; its spoke is drawn.
    def test_discs_that_spin_turn(self):
        text = BALL.replace("FRICTION", "0.2").replace("gravity: [0, -8]", "gravity: [0, 0]").replace("steps: 7", "steps: 8")
        scene = self.write("turns.yaml", text.replace("velocity: [3, 0]", "velocity: [3, 0], inertia: solid, "
                                                      "angle: 0.5, angular_velocity: 7"))
        folder, done = self.solve(scene, "--contact=event,compliant_brax", "--solver=none", "--states", "--json")
        page = os.path.join(self.folder, "turns.html")
        run("saltus_replay", self.write("turns.json", done.stdout), f"--output={page}")
        for path in (os.path.join(folder, "report.html"), page):
            self.open(path)
            for time in (0.0, 0.3, 0.77, 1.0):
                angles = self.js("return saltusReplays[0].motions.map((motion) => motion.angleAt(arguments[0], 0))", time)
                self.assertGreaterEqual(len(angles), 2)
                for angle in angles:
                    self.assertAlmostEqual(angle, 0.5 + 7 * time, delta=2e-5)
            picture = "saltusReplays[0].seek(0.5); return document.querySelector('.replay canvas').toDataURL()"
            turning = self.js(picture)
            self.js("for (const motion of saltusReplays[0].motions) motion.angles = null")
            self.assertNotEqual(self.js(picture), turning)

    # The torque of each interval, in N m, and an arc that shows it.
    def test_torques_are_drawn(self):
        text = BALL.replace("FRICTION", "0.2").replace("velocity: [3, 0]", "velocity: [3, 0], inertia: solid")
        control = "control: {bodies: [ball], torque: [ball], initial: [[0, 0, 0.02]]}\n"
        scene = self.write("turned.yaml", text + control)
        folder, _ = self.solve(scene, "--contact=event", "--solver=none")
        page = os.path.join(self.folder, "turned.html")
        run("saltus_replay", os.path.join(folder, "falls_event_none.npz"), f"--output={page}")
        for path in (os.path.join(folder, "report.html"), page):
            self.open(path)
            torques = self.js("return saltusReplays[0].motions[0].torquesAt(0.3)")
            self.assertEqual(len(torques), 1)
            self.assertAlmostEqual(torques[0][1], 0.02, delta=1e-7)
            picture = "saltusReplays[0].seek(0.3); return document.querySelector('.replay canvas').toDataURL()"
            turning = self.js(picture)
            self.js("for (const motion of saltusReplays[0].motions) motion.torques = null")
            self.assertNotEqual(self.js(picture), turning)

    def test_names_are_text(self):
        states = [[[0.1 * k, 0], [1, 0]] for k in range(11)]
        document = {
            "bodies": [{"name": STRANGE, "radius": 0.1}, {"name": "b", "radius": 0.2, "fixed": True}],
            "planes": [{"name": STRANGE + "!", "point": [0, -0.1], "normal": [0, 2]}],
            "name": STRANGE,
            "times": [0.1 * k for k in range(11)],
            "states": states,
            "touches": [{"a": STRANGE, "b": STRANGE + "!", "begin": 0.5}],
        }
        page = os.path.join(self.folder, "names.html")
        run("saltus_replay", self.write("names.json", json.dumps(document)), f"--output={page}")
        self.assert_valid(page)
        self.assert_fits(page)  # the last time at 1600 pixels, of which a page without contents takes its share
        self.assertGreater(self.js("return document.querySelector('.replay').clientWidth"), 1000)
        self.open(page)
        values = self.shown_values()
        self.assertIn((STRANGE, STRANGE), values)
        self.assertAlmostEqual(values[(STRANGE, STRANGE)][2], 1, delta=1e-5)  # by differences
        self.assertIn(STRANGE, self.js("return document.querySelector('.replay canvas').getAttribute('aria-label')"))
        self.assertEqual(self.js("return document.querySelectorAll('.replay b').length"), 1)  # "Figure 1."

    # Where a run has its own walls, they are drawn in its colour: next to those of the first, or alone if the first is hidden.
    def test_each_motion_has_its_own_walls(self):
        states = {"times": [0, 1], "states": [[[0, 2, 0, 0]], [[0, 1.5, 0, 0]]]}
        floor = lambda height: [{"name": "floor", "point": [0, height], "normal": [0, 1]}]  # noqa: E731
        wall, bodies = {"name": "side", "point": [-2, 0], "normal": [1, 0]}, [{"name": "ball", "radius": 0.3}]
        runs = [{"contact": "event", **states}, {"contact": "lcp", "parameters": {"offset.floor": 1}, "bodies": bodies,
                                                "planes": [*floor(1), wall], **states}]
        page = os.path.join(self.folder, "walls.html")
        document = {"bodies": bodies, "planes": [*floor(0), wall], "runs": runs}
        run("saltus_replay", self.write("walls.json", json.dumps(document)), f"--output={page}")
        self.open(page)
        colour_at = """
            const {view} = saltusReplays[0], ratio = window.devicePixelRatio || 1, copy = document.createElement('canvas');
            Object.assign(copy, {width: view.canvas.width, height: view.canvas.height});
            const context = copy.getContext('2d', {willReadFrequently: true});
            context.drawImage(view.canvas, 0, 0);
            return [...context.getImageData(ratio * view.toX(arguments[0]), ratio * view.toY(arguments[1]), 1, 1).data];"""
        self.js("Object.assign(saltusReplays[0].options, {paths: false, trails: false}); saltusReplays[0].redraw()")
        ground, own = self.js(colour_at, 1, -0.1), self.js(colour_at, 1, 1)
        self.assertNotIn(own, [ground, [0, 0, 0, 0]])
        self.assertNotEqual(self.js(colour_at, -2, 0.5), own)  # both have the wall at the side
        self.assertEqual(self.js(colour_at, 1, 0.5), [0, 0, 0, 0])
        self.js("saltusReplays[0].motions[0].visible = false; saltusReplays[0].redraw()")
        self.assertEqual(self.js(colour_at, 1, 0.5), ground)
        self.assert_quiet()

    # A million numbers of discs that collide at random times stay under 4 MB; and what is read is what was written.
    def test_data_are_compact_and_kept(self):
        seed, discs, rows = 12345, 50, 5000

        def random():
            nonlocal seed
            seed = (1103515245 * seed + 12345) % 2**31
            return seed / 2**30 - 1

        state = [[10 * random(), 10 * random(), random(), random()] for _ in range(discs)]
        states = []
        for _ in range(rows):
            states.append([list(disc) for disc in state])
            for disc in state:
                if random() > 0.96:
                    disc[2:] = [random(), random()]
                disc[0] += 0.01 * disc[2]
                disc[1] += 0.01 * disc[3]
                disc[3] -= 1e-4
        document = {"bodies": [{"name": f"d{i}", "radius": 0.5} for i in range(discs)],
                    "times": [0.01 * k for k in range(rows)], "states": states}
        page = os.path.join(self.folder, "million.html")
        run("saltus_replay", self.write("million.json", json.dumps(document)), f"--output={page}")
        self.assertLess(os.path.getsize(page), 4e6)
        self.open(page)
        kept = self.js("return [...saltusReplays[0].motions[0].states.slice(-4 * arguments[0])]", discs)
        flat = [value for disc in states[-1] for value in disc]
        size = max(flat) - min(flat)
        for column, (found, expected) in enumerate(zip(kept, flat)):
            self.assertAlmostEqual(found, expected, delta=1e-6 * (size if column % 4 < 2 else 1))


if __name__ == "__main__":
    main()
