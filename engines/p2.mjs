// p2: discs as they are, half-planes as planes.
import * as p2 from 'p2-es';
import { serve, versionOf } from './protocol.mjs';

function make(scene, initial) {
  const world = new p2.World({ gravity: scene.gravity });
  world.defaultContactMaterial.restitution = scene.restitution;
  world.defaultContactMaterial.friction = scene.friction;
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const disc = scene.discs[i];
    const body = new p2.Body({ mass: disc.fixed ? 0 : disc.mass, position: [x, y], velocity: [vx, vy],
      fixedRotation: true, damping: 0, angularDamping: 0 });
    body.addShape(new p2.Circle({ radius: disc.radius }));
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
  };
}

await serve({ name: `p2-es ${await versionOf('p2-es')}`, make });
