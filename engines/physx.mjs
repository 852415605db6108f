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

function addDisc(world, disc, material, flags, [x, y, vx, vy]) {
  const place = vector(x, y, (at) => new px.PxTransform(at, new px.PxQuat(px.PxIDENTITYEnum.PxIdentity)));
  const geometry = new px.PxSphereGeometry(disc.radius);
  const shape = physics.createShape(geometry, material, true, flags);
  shape.setSimulationFilterData(collide);
  const body = disc.fixed ? physics.createRigidStatic(place) : physics.createRigidDynamic(place);
  body.attachShape(shape);
  if (!disc.fixed) {
    px.PxRigidBodyExt.prototype.setMassAndUpdateInertia(body, disc.mass);
    body.setLinearDamping(0);
    body.setAngularDamping(0);
    body.setSleepThreshold(0);
    const lock = px.PxRigidDynamicLockFlagEnum;
    for (const flag of [lock.eLOCK_LINEAR_Z, lock.eLOCK_ANGULAR_X, lock.eLOCK_ANGULAR_Y, lock.eLOCK_ANGULAR_Z]) {
      body.setRigidDynamicLockFlag(flag, true);
    }
    vector(vx, vy, (velocity) => body.setLinearVelocity(velocity));
  }
  world.addActor(body);
  shape.release();
  px.destroy(geometry);
  px.destroy(place);
  return body;
}

function addPlane(world, { point, normal }, material) {
  const height = normal[0] * point[0] + normal[1] * point[1];
  const plane = vector(...normal, (n) => new px.PxPlane(n, -height));
  const body = top.CreatePlane(physics, plane, material);
  px.destroy(plane);
  world.addActor(body);
  return body;
}

function make(scene, initial) {
  const world = newWorld(scene.gravity);
  const material = physics.createMaterial(scene.friction, scene.friction, scene.restitution);
  const flags = new px.PxShapeFlags(px.PxShapeFlagEnum.eSIMULATION_SHAPE);
  const bodies = initial.map((state, i) => addDisc(world, scene.discs[i], material, flags, state));
  const grounds = scene.planes.map((plane) => addPlane(world, plane, material));
  px.destroy(flags);
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
