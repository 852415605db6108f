// planck: discs and boxes as they are, half-planes as long edges.
import * as planck from 'planck';
import { serve, versionOf } from './protocol.mjs';

const FAR = 1000;  // m, half the length of an edge

function make(scene, initial) {
  const world = new planck.World({ gravity: { x: scene.gravity[0], y: scene.gravity[1] }, allowSleep: false });
  const surface = { restitution: scene.restitution, friction: scene.friction, density: 1 };
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const given = scene.bodies[i];
    const body = world.createBody({ type: given.fixed ? 'static' : 'dynamic', position: { x, y },
      linearVelocity: { x: vx, y: vy }, fixedRotation: !given.inertia, angle: given.angle, angularVelocity: given.spin });
    body.createFixture({ shape: given.radius ? new planck.Circle(given.radius) : new planck.Box(...given.half), ...surface });
    if (!given.fixed) body.setMassData({ mass: given.mass, center: { x: 0, y: 0 }, I: given.inertia });
    return body;
  });
  for (const { point: [x, y], normal: [nx, ny] } of scene.planes) {
    const [from, to] = [-FAR, FAR].map((s) => ({ x: x + s * ny, y: y - s * nx }));
    world.createBody().createFixture({ shape: new planck.Edge(from, to), ...surface });
  }
  return {
    push: (disc, fx, fy) => bodies[disc].applyForceToCenter({ x: fx, y: fy }, true),
    step: (h) => world.step(h),
    get: (disc) => {
      const p = bodies[disc].getPosition(), v = bodies[disc].getLinearVelocity();
      return [p.x, p.y, v.x, v.y];
    },
    turn: (body) => [bodies[body].getAngle(), bodies[body].getAngularVelocity()],
  };
}

await serve({ name: `planck ${await versionOf('planck')}`, make, boxes: true });
