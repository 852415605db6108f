// Makes a simulator a command for `saltus_audit --simulate=COMMAND`: copy this file, write a world, call serve. The
// protocol is described at the top of protocol.h.
//
// A world has push(disc, fx, fy): a force in N on the centre of a disc, in the next step only; step(h), in s; get(disc),
// which returns [px, py, vx, vy]; and, where it must be given back, free(). Discs do not turn.
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

// {gravity, discs: [{radius, mass, fixed}], planes: [{point, normal}], restitution, friction, controlled: [disc]}; normals
// have length 1.
function readScene(scene) {
  refuseUnknown(scene, 'scene', ['name', 'duration', 'steps', 'gravity', 'bodies', 'planes', 'contact', 'control',
    'objective', 'optimize', 'free', 'no_contact']);
  const names = scene.bodies.map((body) => body.name);
  const discs = scene.bodies.map((body) => {
    refuseUnknown(body, 'a body', ['name', 'radius', 'mass', 'fixed', 'position', 'velocity']);
    return { radius: body.radius, mass: body.fixed ? 1 : body.mass, fixed: Boolean(body.fixed) };
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
  return { gravity: scene.gravity ?? [0, 0], discs, planes, controlled, restitution: contact.restitution ?? 1,
    friction: contact.friction ?? 0 };
}

// All states of the world; throws if one is not finite.
function states(world, scene, initial) {
  return initial.map((at, disc) => {
    if (scene.discs[disc].fixed) return at;
    const state = world.get(disc);
    if (!state.every(Number.isFinite)) throw new Error(`the state of disc ${disc} is not finite`);
    return state;
  });
}

function checkRequest(scene, { steps, duration, initial, control }) {
  if (!(Number.isInteger(steps) && steps > 0 && duration > 0)) throw new Error('steps and duration must be positive');
  if (initial.length !== scene.discs.length) throw new Error(`initial: expected ${scene.discs.length} rows, one a body`);
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
      scene.controlled.forEach((disc, c) => world.push(disc, forces[c][0], forces[c][1]));
      world.step(h);
      all?.push(states(world, scene, initial));
    }
    const final = states(world, scene, initial);
    return all ? { final, states: all } : { final };
  } finally {
    world.free?.();
  }
}

// Answers standard input until it ends. simulator: {name, make(scene, initial, h), refusal?(scene)}, where make returns a
// new world, with nothing left of an earlier one, and refusal says why a scene cannot be taken ('' if it can).
export async function serve(simulator) {
  console.log = console.error;  // standard output is for answers
  let scene;
  for await (const line of createInterface({ input: process.stdin })) {
    let answer = {};
    try {
      const request = JSON.parse(line);
      if (request.id !== undefined) answer.id = request.id;
      if (request.saltus) {
        answer = { name: simulator.name, can: ['states'] };
        scene = readScene(request.scene);
        const refusal = simulator.refusal?.(scene);
        if (refusal) throw new NotApplicable(refusal);
      } else if (request.simulate) {
        Object.assign(answer, simulate(simulator, scene, request.simulate));
      } else {
        throw new Error('expected "saltus" or "simulate"');
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
