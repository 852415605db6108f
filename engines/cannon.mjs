// cannon: discs as spheres that stay in the plane z = 0, half-planes as planes.
import * as cannon from 'cannon-es';
import { serve, versionOf } from './protocol.mjs';

function make(scene, initial) {
  const world = new cannon.World({ gravity: new cannon.Vec3(...scene.gravity, 0) });
  world.defaultContactMaterial.restitution = scene.restitution;
  world.defaultContactMaterial.friction = scene.friction;
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const disc = scene.bodies[i];
    const body = new cannon.Body({ mass: disc.fixed ? 0 : disc.mass, position: new cannon.Vec3(x, y, 0),
      velocity: new cannon.Vec3(vx, vy, 0), shape: new cannon.Sphere(disc.radius), linearDamping: 0,
      linearFactor: new cannon.Vec3(1, 1, 0), fixedRotation: true });
    world.addBody(body);
    return body;
  });
  for (const { point, normal } of scene.planes) {
    const body = new cannon.Body({ mass: 0, position: new cannon.Vec3(...point, 0), shape: new cannon.Plane() });
    body.quaternion.setFromVectors(new cannon.Vec3(0, 0, 1), new cannon.Vec3(...normal, 0));
    world.addBody(body);
  }
  return {
    push: (disc, fx, fy) => bodies[disc].applyForce(new cannon.Vec3(fx, fy, 0)),
    step: (h) => world.step(h),
    get: (disc) => {
      const { position: p, velocity: v } = bodies[disc];
      return [p.x, p.y, v.x, v.y];
    },
  };
}

await serve({ name: `cannon-es ${await versionOf('cannon-es')}`, make });
