// p2: discs and boxes as they are, half-planes as planes.
import * as p2 from 'p2-es';
import { serve, versionOf } from './protocol.mjs';

function make(scene, initial) {
  const world = new p2.World({ gravity: scene.gravity });
  world.defaultContactMaterial.restitution = scene.restitution;
  world.defaultContactMaterial.friction = scene.friction;
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const given = scene.bodies[i];
    const body = new p2.Body({ mass: given.fixed ? 0 : given.mass, position: [x, y], velocity: [vx, vy],
      angle: given.angle, angularVelocity: given.spin, fixedRotation: !given.inertia, damping: 0, angularDamping: 0 });
    const [width, height] = (given.half ?? []).map((half) => 2 * half);
    body.addShape(given.radius ? new p2.Circle({ radius: given.radius }) : new p2.Box({ width, height }));
    if (given.inertia) {
      body.inertia = given.inertia;
      body.invInertia = 1 / given.inertia;
    }
    world.addBody(body);
    return body;
  });
  for (const { point, normal: [nx, ny] } of scene.planes) {
    const body = new p2.Body({ mass: 0, position: point, angle: Math.atan2(-nx, ny) });
    body.addShape(new p2.Plane());
    world.addBody(body);
  }
  return {
    push: (disc, fx, fy) => bodies[disc].applyForce([fx, fy]),
    step: (h) => world.step(h),
    get: (disc) => [...bodies[disc].position, ...bodies[disc].velocity],
    turn: (body) => [bodies[body].angle, bodies[body].angularVelocity],
  };
}

await serve({ name: `p2-es ${await versionOf('p2-es')}`, make, boxes: true });
