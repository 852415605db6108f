// Box2D 3: discs and boxes as they are, half-planes as long segments. --substeps=N of each step, 4 unless given.
import Box2D from 'box2d3-wasm';
import { argument, serve, versionOf } from './protocol.mjs';

const FAR = 1000;  // m, half the length of a segment
const b2 = await Box2D();
const substeps = Number(argument('substeps') ?? 4);

// Calls use with what make returns, an object of the module's memory, and gives it back.
function using(made, use) {
  try {
    return use(made);
  } finally {
    made.delete();
  }
}
const vector = (x, y, use) => using(new b2.b2Vec2(x, y), use);

// A definition of a shape with the surface of the scene.
function shapeDefinition(scene) {
  const definition = b2.b2DefaultShapeDef();
  definition.material.restitution = scene.restitution;
  definition.material.friction = scene.friction;
  return definition;
}

function addBody(world, scene, given, [x, y, vx, vy]) {
  const definition = b2.b2DefaultBodyDef();
  definition.type = given.fixed ? b2.b2BodyType.b2_staticBody : b2.b2BodyType.b2_dynamicBody;
  vector(x, y, (at) => { definition.position = at; });
  vector(vx, vy, (at) => { definition.linearVelocity = at; });
  using(new b2.b2MotionLocks(), (locks) => {
    locks.linearX = locks.linearY = false;
    locks.angularZ = !given.inertia;
    definition.motionLocks = locks;
  });
  using(b2.b2MakeRot(given.angle), (turned) => { definition.rotation = turned; });
  definition.angularVelocity = given.spin;
  const body = using(definition, () => b2.b2CreateBody(world, definition));
  using(shapeDefinition(scene), (shape) => {
    if (!given.radius) return using(b2.b2MakeBox(...given.half), (box) => b2.b2CreatePolygonShape(body, shape, box));
    return using(new b2.b2Circle(), (circle) => {
      vector(0, 0, (centre) => { circle.center = centre; });
      circle.radius = given.radius;
      b2.b2CreateCircleShape(body, shape, circle);
    });
  });
  if (!given.fixed) {
    using(new b2.b2MassData(), (mass) => {
      vector(0, 0, (centre) => { mass.center = centre; });
      mass.mass = given.mass;
      mass.rotationalInertia = given.inertia;
      b2.b2Body_SetMassData(body, mass);
    });
  }
  return body;
}

function addPlane(world, scene, { point: [x, y], normal: [nx, ny] }) {
  const body = using(b2.b2DefaultBodyDef(), (definition) => b2.b2CreateBody(world, definition));
  using(new b2.b2Segment(), (segment) => {
    vector(x - FAR * ny, y + FAR * nx, (end) => { segment.point1 = end; });
    vector(x + FAR * ny, y - FAR * nx, (end) => { segment.point2 = end; });
    using(shapeDefinition(scene), (shape) => b2.b2CreateSegmentShape(body, shape, segment));
  });
}

function make(scene, initial) {
  const definition = b2.b2DefaultWorldDef();
  vector(...scene.gravity, (gravity) => { definition.gravity = gravity; });
  definition.enableSleep = false;
  const world = using(definition, () => b2.b2CreateWorld(definition));
  const bodies = initial.map((state, i) => addBody(world, scene, scene.bodies[i], state));
  for (const plane of scene.planes) addPlane(world, scene, plane);
  const numbers = (v) => using(v, () => [v.x, v.y]);
  return {
    push: (disc, fx, fy) => vector(fx, fy, (force) => b2.b2Body_ApplyForceToCenter(bodies[disc], force, true)),
    step: (h) => b2.b2World_Step(world, h, substeps),
    get: (disc) => [...numbers(b2.b2Body_GetPosition(bodies[disc])), ...numbers(b2.b2Body_GetLinearVelocity(bodies[disc]))],
    turn: (body) => [using(b2.b2Body_GetRotation(bodies[body]), (turned) => b2.b2Rot_GetAngle(turned)),
      b2.b2Body_GetAngularVelocity(bodies[body])],
    free: () => b2.b2DestroyWorld(world),
  };
}

await serve({ name: `Box2D 3 (box2d3-wasm ${await versionOf('box2d3-wasm')}), ${substeps} substeps`, make, boxes: true });
process.exit(0);  // its threads would wait on
