// PhysX: discs as spheres that stay in the plane z = 0, half-planes as planes. --tgs takes its other solver.
import { readFile } from 'node:fs/promises';
import { argument, serve, versionOf } from './protocol.mjs';

// The package is built for browsers, and refuses to load where it sees Node.
async function load() {
  const { default: PhysX } = await import('physx-js-webidl');
  const wasmBinary = await readFile(new URL('node_modules/physx-js-webidl/physx-js-webidl.wasm', import.meta.url));
  const { process } = globalThis;
  const browser = { window: globalThis, document: { currentScript: null }, location: { href: 'http://localhost/' } };
  for (const [name, value] of Object.entries(browser)) {
    Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
  }
  Object.defineProperty(globalThis, 'process', { value: undefined, configurable: true, writable: true });
  try {
    return await PhysX({ wasmBinary, print: console.error, printErr: console.error });
  } finally {
    globalThis.process = process;
    for (const name of Object.keys(browser)) delete globalThis[name];
  }
}

const px = await load();
const top = px.PxTopLevelFunctions.prototype;
const foundation = top.CreateFoundation(px.PHYSICS_VERSION, new px.PxDefaultAllocator(), new px.PxDefaultErrorCallback());
const scale = new px.PxTolerancesScale();
const physics = top.CreatePhysics(px.PHYSICS_VERSION, foundation, scale);
const dispatcher = top.DefaultCpuDispatcherCreate(0);
const collide = new px.PxFilterData(1, 1, 0, 0);
const tgs = Boolean(argument('tgs'));

// Calls use with a vector, and gives its memory back.
function vector(x, y, use) {
  const made = new px.PxVec3(x, y, 0);
  try {
    return use(made);
  } finally {
    px.destroy(made);
  }
}

function newWorld(gravity) {
  const definition = new px.PxSceneDesc(scale);
  vector(...gravity, (g) => { definition.gravity = g; });
  definition.cpuDispatcher = dispatcher;
  definition.filterShader = top.DefaultFilterShader();
  if (tgs) definition.solverType = px.PxSolverTypeEnum.eTGS;
  const world = physics.createScene(definition);
  px.destroy(definition);
  return world;
}

// angle: of the turn about z.
function place(x, y, angle, use) {
  const turn = new px.PxQuat(0, 0, Math.sin(angle / 2), Math.cos(angle / 2));
  const made = vector(x, y, (at) => new px.PxTransform(at, turn));
  try {
    return use(made);
  } finally {
    px.destroy(made);
    px.destroy(turn);
  }
}

function addShape(world, body, geometry, material) {
  const flags = new px.PxShapeFlags(px.PxShapeFlagEnum.eSIMULATION_SHAPE);
  const shape = physics.createShape(geometry, material, true, flags);
  shape.setSimulationFilterData(collide);
  body.attachShape(shape);
  world.addActor(body);
  shape.release();
  px.destroy(flags);
  px.destroy(geometry);
}

function addDisc(world, disc, material, [x, y, vx, vy]) {
  const body = place(x, y, 0, (at) => (disc.fixed ? physics.createRigidStatic(at) : physics.createRigidDynamic(at)));
  addShape(world, body, new px.PxSphereGeometry(disc.radius), material);
  if (disc.fixed) return body;
  px.PxRigidBodyExt.prototype.setMassAndUpdateInertia(body, disc.mass);
  body.setLinearDamping(0);
  body.setAngularDamping(0);
  body.setSleepThreshold(0);
  const lock = px.PxRigidDynamicLockFlagEnum;
  for (const flag of [lock.eLOCK_LINEAR_Z, lock.eLOCK_ANGULAR_X, lock.eLOCK_ANGULAR_Y, lock.eLOCK_ANGULAR_Z]) {
    body.setRigidDynamicLockFlag(flag, true);
  }
  vector(vx, vy, (velocity) => body.setLinearVelocity(velocity));
  return body;
}

// PhysX' planes look along x.
function addPlane(world, { point: [x, y], normal: [nx, ny] }, material) {
  const body = place(x, y, Math.atan2(ny, nx), (at) => physics.createRigidStatic(at));
  addShape(world, body, new px.PxPlaneGeometry(), material);
  return body;
}

function make(scene, initial) {
  const world = newWorld(scene.gravity);
  const material = physics.createMaterial(scene.friction, scene.friction, scene.restitution);
  const bodies = initial.map((state, i) => addDisc(world, scene.bodies[i], material, state));
  const grounds = scene.planes.map((plane) => addPlane(world, plane, material));
  return {
    push: (disc, fx, fy) => vector(fx, fy, (force) => bodies[disc].addForce(force)),
    step: (h) => {
      world.simulate(h);
      world.fetchResults(true);
    },
    get: (disc) => {
      const { p } = bodies[disc].getGlobalPose(), place = [p.x, p.y];
      const v = bodies[disc].getLinearVelocity();
      return [...place, v.x, v.y];
    },
    free: () => {
      for (const body of [...bodies, ...grounds]) body.release();
      material.release();
      world.release();
    },
  };
}

await serve({ name: `PhysX (physx-js-webidl ${await versionOf('physx-js-webidl')}), ${tgs ? 'TGS' : 'PGS'}`, make });
