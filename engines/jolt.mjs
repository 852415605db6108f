// Jolt: discs as spheres that stay in the plane z = 0, half-planes as planes.
import load from 'jolt-physics';
import { serve, versionOf } from './protocol.mjs';

const Jolt = await load();
const FIXED = 0, MOVING = 1, LAYERS = 2;
const FAR = 1000;  // m, half the size of a plane

// Calls use with a vector, and gives its memory back.
function vector(x, y, use, Type = Jolt.Vec3) {
  const made = new Type(x, y, 0);
  try {
    return use(made);
  } finally {
    Jolt.destroy(made);
  }
}

// A new world; fixed bodies do not collide with each other.
function newWorld() {
  const settings = new Jolt.JoltSettings();
  const pairs = new Jolt.ObjectLayerPairFilterTable(LAYERS);
  pairs.EnableCollision(FIXED, MOVING);
  pairs.EnableCollision(MOVING, MOVING);
  const phases = new Jolt.BroadPhaseLayerInterfaceTable(LAYERS, LAYERS);
  for (const layer of [FIXED, MOVING]) {
    const phase = new Jolt.BroadPhaseLayer(layer);
    phases.MapObjectToBroadPhaseLayer(layer, phase);
    Jolt.destroy(phase);
  }
  settings.mObjectLayerPairFilter = pairs;
  settings.mBroadPhaseLayerInterface = phases;
  settings.mObjectVsBroadPhaseLayerFilter = new Jolt.ObjectVsBroadPhaseLayerFilterTable(phases, LAYERS, pairs, LAYERS);
  const world = new Jolt.JoltInterface(settings);  // owns the filters from now on
  Jolt.destroy(settings);
  return world;
}

function addBody(bodies, scene, shape, at, mass) {
  const [x, y, vx, vy] = at;
  const rotation = new Jolt.Quat(0, 0, 0, 1);
  const settings = vector(x, y, (position) => new Jolt.BodyCreationSettings(shape, position, rotation,
    mass ? Jolt.EMotionType_Dynamic : Jolt.EMotionType_Static, mass ? MOVING : FIXED), Jolt.RVec3);
  settings.mRestitution = scene.restitution;
  settings.mFriction = scene.friction;
  settings.mLinearDamping = settings.mAngularDamping = 0;
  settings.mAllowSleeping = false;
  if (mass) {
    settings.mAllowedDOFs = Jolt.EAllowedDOFs_TranslationX | Jolt.EAllowedDOFs_TranslationY;
    settings.mOverrideMassProperties = Jolt.EOverrideMassProperties_CalculateInertia;
    settings.mMassPropertiesOverride.mMass = mass;
    vector(vx, vy, (velocity) => { settings.mLinearVelocity = velocity; });
  }
  const body = bodies.CreateBody(settings);
  bodies.AddBody(body.GetID(), Jolt.EActivation_Activate);
  Jolt.destroy(settings);
  Jolt.destroy(rotation);
  return body;
}

function planeShape({ point, normal }) {
  const height = normal[0] * point[0] + normal[1] * point[1];
  const plane = vector(...normal, (n) => new Jolt.Plane(n, -height));
  const shape = new Jolt.PlaneShape(plane, null, FAR);
  Jolt.destroy(plane);
  return shape;
}

function make(scene, initial) {
  const world = newWorld();
  const physics = world.GetPhysicsSystem();
  vector(...scene.gravity, (gravity) => physics.SetGravity(gravity));
  const all = physics.GetBodyInterface();
  const bodies = initial.map((state, i) => {
    const disc = scene.bodies[i];
    return addBody(all, scene, new Jolt.SphereShape(disc.radius, null), state, disc.fixed ? 0 : disc.mass);
  });
  const grounds = scene.planes.map((plane) => addBody(all, scene, planeShape(plane), [0, 0, 0, 0], 0));
  return {
    push: (disc, fx, fy) => vector(fx, fy, (force) => bodies[disc].AddForce(force)),
    step: (h) => world.Step(h, 1),
    get: (disc) => {
      const p = bodies[disc].GetPosition(), state = [p.GetX(), p.GetY()];
      const v = bodies[disc].GetLinearVelocity();
      return [...state, v.GetX(), v.GetY()];
    },
    free: () => {
      for (const body of [...bodies, ...grounds]) {
        const id = body.GetID();
        all.RemoveBody(id);
        all.DestroyBody(id);
      }
      Jolt.destroy(world);
    },
  };
}

await serve({ name: `Jolt (jolt-physics ${await versionOf('jolt-physics')})`, make });
