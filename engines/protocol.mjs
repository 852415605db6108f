// Makes a simulator a command for `saltus_audit --simulate=COMMAND`: copy this file, write a world, call serve. The
// protocol is described at the top of protocol.h.
//
// A world has push(body, fx, fy): a force in N on the centre of a body, in the next step only; step(h), in s; get(body),
// which returns [px, py, vx, vy]; if bodies turn, turn(body), which returns the angle and the angular velocity; and, where
// it must be given back, free().
import { createInterface } from 'node:readline';

// A scene that the simulator cannot take: the reason.
export class NotApplicable extends Error {}

const isNothing = (value) =>
  !value || (Array.isArray(value) && value.length === 0) || (value.constructor === Object && Object.keys(value).length === 0);

// What is not among `known` must be empty, 0 or false: else it may act on the motion.
function refuseUnknown(object, where, known) {
  for (const [key, value] of Object.entries(object)) {
    if (!known.includes(key) && !isNothing(value)) throw new NotApplicable(`${where}: this driver does not support "${key}"`);
  }
}

// {gravity, bodies: [{radius, mass, fixed, half, inertia, angle, spin, position}], planes: [{point, normal}], restitution,
// friction, controlled: [body]}; normals have length 1. The meaning is that in protocol.h; boxes have no radius.
// hybrid: a scene of saltus_bodies.
function readScene(scene, hybrid) {
  refuseUnknown(scene, 'scene', ['name', 'duration', 'steps', 'gravity', 'bodies', 'planes', 'contact', 'control',
    'objective', 'optimize', 'free', 'no_contact', ...(hybrid ? ['frictionless'] : [])]);
  const names = scene.bodies.map((body) => body.name);
  const known = ['name', 'radius', 'mass', 'fixed', 'position', 'velocity', ...(hybrid ? ['box', 'inertia', 'angle'] : [])];
  const bodies = scene.bodies.map((body) => {
    refuseUnknown(body, 'a body', known);
    const given = { radius: body.radius ?? 0, mass: body.fixed ? 1 : body.mass, fixed: Boolean(body.fixed) };
    const turns = { half: body.box, inertia: body.fixed ? 0 : body.inertia, angle: body.angle, spin: 0, position: body.position };
    return hybrid ? { ...given, ...turns } : { ...given, inertia: 0, angle: 0, spin: 0 };
  });
  const planes = (scene.planes ?? []).map((plane) => {
    refuseUnknown(plane, 'a plane', ['name', 'point', 'normal']);
    const length = Math.hypot(...plane.normal);
    return { point: plane.point, normal: plane.normal.map((x) => x / length) };
  });
  const contact = scene.contact ?? {};
  refuseUnknown(contact, 'contact', ['restitution', 'friction', 'stiffness', 'damping']);
  const controlled = (scene.control?.bodies ?? []).map((name) => {
    if (!names.includes(name)) throw new Error(`control: no body is named ${name}`);
    return names.indexOf(name);
  });
  return { gravity: scene.gravity ?? [0, 0], bodies, planes, controlled, restitution: contact.restitution ?? 1,
    friction: contact.friction ?? 0, frictionless: scene.frictionless };
}

// All states of the world; throws if one is not finite.
function states(world, scene, initial) {
  return initial.map((at, body) => {
    if (scene.bodies[body].fixed) return at;
    const state = world.get(body);
    if (!state.every(Number.isFinite)) throw new Error(`the state of body ${body} is not finite`);
    return state;
  });
}

function checkRequest(scene, { steps, duration, initial, control }) {
  if (!(Number.isInteger(steps) && steps > 0 && duration > 0)) throw new Error('steps and duration must be positive');
  if (initial.length !== scene.bodies.length) throw new Error(`initial: expected ${scene.bodies.length} rows, one a body`);
  if (scene.controlled.length > 0 && control.length !== 1 && control.length !== steps) {
    throw new Error(`control: expected 1 or ${steps} rows, not ${control.length}`);
  }
  if (control.some((row) => row.length !== scene.controlled.length)) {
    throw new Error(`control: expected ${scene.controlled.length} forces a row`);
  }
}

// The answer to one "simulate", without its id.
function simulate(simulator, scene, request) {
  const { steps, duration, initial, control = [] } = request;
  checkRequest(scene, { steps, duration, initial, control });
  const h = duration / steps;
  const world = simulator.make(scene, initial, h);
  const all = request.states ? [initial] : undefined;
  try {
    for (let k = 0; k < steps; ++k) {
      const forces = control[control.length === 1 ? 0 : k];
      scene.controlled.forEach((body, c) => world.push(body, forces[c][0], forces[c][1]));
      world.step(h);
      all?.push(states(world, scene, initial));
    }
    const final = states(world, scene, initial);
    return all ? { final, states: all } : { final };
  } finally {
    world.free?.();
  }
}

// The answer to one "step", without its id.
function oneStep(simulator, scene, { mode, h, state, parameters: [restitution, friction, ...gravity] }) {
  const n = state.length / 2;
  let next = -3;
  const bodies = scene.bodies.map((body) => {
    if (body.fixed) return body;
    next += 3;
    return { ...body, angle: state[next + 2], spin: state[n + next + 2], at: next };
  });
  if (n !== next + 3 || gravity.length !== 2) throw new Error('a state of another size');
  const initial = bodies.map(({ fixed, position, at }) =>
    (fixed ? [...position, 0, 0] : [state[at], state[at + 1], state[n + at], state[n + at + 1]]));
  const now = { ...scene, bodies, gravity, restitution: Math.max(restitution, 0),
    friction: scene.frictionless ? 0 : Math.max(friction, 0) };
  const world = simulator.make(now, initial, h);
  try {
    world.step(h);
    const after = new Array(2 * n);
    states(world, now, initial).forEach(([x, y, vx, vy], i) => {
      const { fixed, at, angle } = bodies[i];
      if (fixed) return;
      const [turned, spin] = world.turn(i);
      // Some worlds have angles from -pi to pi only.
      const jump = Math.round((turned - angle) / (2 * Math.PI));
      [after[at], after[at + 1], after[at + 2]] = [x, y, jump ? turned - 2 * Math.PI * jump : turned];
      [after[n + at], after[n + at + 1], after[n + at + 2]] = [vx, vy, spin];
    });
    return { mode, state: after };
  } finally {
    world.free?.();
  }
}

// Answers standard input until it ends. simulator: {name, make(scene, initial, h), refusal?(scene), boxes?}, where make
// returns a new world, with nothing left of an earlier one, refusal says why a scene cannot be taken ('' if it can), and
// boxes says whether its worlds have boxes and bodies that turn.
export async function serve(simulator) {
  console.log = console.error;  // standard output is for answers
  let scene;
  for await (const line of createInterface({ input: process.stdin })) {
    let answer = {};
    try {
      const request = JSON.parse(line);
      if (request.id !== undefined) answer.id = request.id;
      if (request.saltus) {
        const hybrid = Boolean(request.hybrid);
        answer = { name: simulator.name, ...(hybrid ? {} : { can: ['states'] }) };
        if (hybrid && !simulator.boxes) throw new NotApplicable('this driver has discs that do not turn only');
        if (hybrid && !request.scene) throw new NotApplicable('this driver has bodies only, in a "scene"');
        scene = readScene(request.scene, hybrid);
        const refusal = simulator.refusal?.(scene);
        if (refusal) throw new NotApplicable(refusal);
      } else if (request.simulate) {
        Object.assign(answer, simulate(simulator, scene, request.simulate));
      } else if (request.step) {
        Object.assign(answer, oneStep(simulator, scene, request.step));
      } else {
        throw new Error('expected "saltus", "step" or "simulate"');
      }
    } catch (error) {
      answer[error instanceof NotApplicable ? 'not_applicable' : 'error'] = String(error.message ?? error);
    }
    if (!process.stdout.write(JSON.stringify(answer) + '\n')) {
      await new Promise((resolve) => process.stdout.once('drain', resolve));
    }
  }
}

// The value of the argument --name=VALUE, or true for --name alone; undefined if it is not given.
export function argument(name) {
  const given = process.argv.slice(2).find((word) => word === `--${name}` || word.startsWith(`--${name}=`));
  return given === undefined ? undefined : given.includes('=') ? given.slice(name.length + 3) : true;
}

// The version of an installed package.
export async function versionOf(name) {
  const { readFile } = await import('node:fs/promises');
  return JSON.parse(await readFile(new URL(`node_modules/${name}/package.json`, import.meta.url))).version;
}
