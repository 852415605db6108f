// Rapier, 2-D: discs and boxes as they are, half-planes as half-spaces.
import RAPIER from '@dimforge/rapier2d-compat';
import { serve } from './protocol.mjs';

await RAPIER.init();

function make(scene, initial, h) {
  const world = new RAPIER.World({ x: scene.gravity[0], y: scene.gravity[1] });
  world.timestep = h;
  const surface = (collider) => collider.setRestitution(scene.restitution).setFriction(scene.friction);
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const given = scene.bodies[i];
    const description = given.fixed ? RAPIER.RigidBodyDesc.fixed() : RAPIER.RigidBodyDesc.dynamic();
    if (!given.inertia) description.lockRotations();
    const body = world.createRigidBody(description.setTranslation(x, y).setLinvel(vx, vy).setRotation(given.angle)
      .setAngvel(given.spin).setCanSleep(false));
    const shape = given.radius ? RAPIER.ColliderDesc.ball(given.radius) : RAPIER.ColliderDesc.cuboid(...given.half);
    const collider = surface(shape);
    world.createCollider(given.inertia ? collider.setMassProperties(given.mass, { x: 0, y: 0 }, given.inertia)
      : collider.setMass(given.mass), body);
    return body;
  });
  for (const { point, normal } of scene.planes) {
    const halfSpace = RAPIER.ColliderDesc.halfspace({ x: normal[0], y: normal[1] });
    world.createCollider(surface(halfSpace).setTranslation(...point));
  }
  return {
    push: (disc, fx, fy) => bodies[disc].addForce({ x: fx, y: fy }, true),
    step: () => {
      world.step();
      for (const body of bodies) body.resetForces(true);
    },
    get: (disc) => {
      const p = bodies[disc].translation(), v = bodies[disc].linvel();
      return [p.x, p.y, v.x, v.y];
    },
    turn: (body) => [bodies[body].rotation(), bodies[body].angvel()],
    free: () => world.free(),
  };
}

await serve({ name: `Rapier ${RAPIER.version()}`, make, boxes: true });
