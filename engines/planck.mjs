// planck: discs as they are, half-planes as long edges.
import * as planck from 'planck';
import { serve, versionOf } from './protocol.mjs';

const FAR = 1000;  // m, half the length of an edge

function make(scene, initial) {
  const world = new planck.World({ gravity: { x: scene.gravity[0], y: scene.gravity[1] }, allowSleep: false });
  const surface = { restitution: scene.restitution, friction: scene.friction, density: 1 };
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const disc = scene.discs[i];
    const body = world.createBody({ type: disc.fixed ? 'static' : 'dynamic', position: { x, y },
      linearVelocity: { x: vx, y: vy }, fixedRotation: true });
    body.createFixture({ shape: new planck.Circle(disc.radius), ...surface });
    if (!disc.fixed) body.setMassData({ mass: disc.mass, center: { x: 0, y: 0 }, I: 0 });
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
  };
}

await serve({ name: `planck ${await versionOf('planck')}`, make });
