// Matter: boxes as they are, discs as the polygons that it makes of them, half-planes as large rectangles. It is made for pixels and ms.
import matter from 'matter-js';
import { serve, versionOf } from './protocol.mjs';

const METRE = 100;  // px
const FAR = 1000 * METRE;  // the size of a rectangle
const SECOND = 1000;  // ms

function make(scene, initial, h) {
  const [gx, gy] = scene.gravity;
  const engine = matter.Engine.create({ gravity: { x: gx, y: gy, scale: METRE / SECOND ** 2 } });
  const surface = { restitution: scene.restitution, friction: scene.friction, frictionStatic: 0, frictionAir: 0 };
  const perStep = METRE * matter.Body._baseDelta / SECOND;  // Matter's velocities are per 1/60 s
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const given = scene.bodies[i];
    const options = { ...surface, isStatic: given.fixed };
    const [width, height] = (given.half ?? []).map((half) => 2 * half * METRE);
    const body = given.radius ? matter.Bodies.circle(x * METRE, y * METRE, given.radius * METRE, options)
      : matter.Bodies.rectangle(x * METRE, y * METRE, width, height, options);
    matter.Body.setAngle(body, given.angle);
    if (!given.fixed) {
      matter.Body.setMass(body, given.mass);
      matter.Body.setInertia(body, given.inertia ? given.inertia * METRE ** 2 : Infinity);
      body.deltaTime = h * SECOND;
      matter.Body.setVelocity(body, { x: vx * perStep, y: vy * perStep });
      matter.Body.setAngularVelocity(body, given.spin * perStep / METRE);
    }
    return body;
  });
  const grounds = scene.planes.map(({ point: [x, y], normal: [nx, ny] }) =>
    matter.Bodies.rectangle(x * METRE - nx * FAR / 2, y * METRE - ny * FAR / 2, FAR, FAR,
      { ...surface, isStatic: true, angle: Math.atan2(-nx, ny) }));
  matter.Composite.add(engine.world, [...bodies, ...grounds]);
  return {
    push: (disc, fx, fy) => {
      bodies[disc].force.x += fx * METRE / SECOND ** 2;
      bodies[disc].force.y += fy * METRE / SECOND ** 2;
    },
    step: () => matter.Engine.update(engine, h * SECOND),
    get: (disc) => {
      const p = bodies[disc].position, v = matter.Body.getVelocity(bodies[disc]);
      return [p.x / METRE, p.y / METRE, v.x / perStep, v.y / perStep];
    },
    turn: (body) => [bodies[body].angle, matter.Body.getAngularVelocity(bodies[body]) * METRE / perStep],
  };
}

await serve({ name: `matter-js ${await versionOf('matter-js')}`, make, boxes: true });
