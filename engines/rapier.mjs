// Rapier, 2-D: discs as they are, half-planes as half-spaces.
import RAPIER from '@dimforge/rapier2d-compat';
import { serve } from './protocol.mjs';

await RAPIER.init();

function make(scene, initial, h) {
  const world = new RAPIER.World({ x: scene.gravity[0], y: scene.gravity[1] });
  world.timestep = h;
  const surface = (collider) => collider.setRestitution(scene.restitution).setFriction(scene.friction);
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const disc = scene.discs[i];
    const description = disc.fixed ? RAPIER.RigidBodyDesc.fixed() : RAPIER.RigidBodyDesc.dynamic();
    const body = world.createRigidBody(
      description.setTranslation(x, y).setLinvel(vx, vy).lockRotations().setCanSleep(false));
    world.createCollider(surface(RAPIER.ColliderDesc.ball(disc.radius)).setMass(disc.mass), body);
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
    free: () => world.free(),
  };
}

await serve({ name: `Rapier ${RAPIER.version()}`, make });
