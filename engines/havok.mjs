// Havok: discs as spheres, half-planes as large boxes. Forces are given as the impulse of a step.
import { readFile } from 'node:fs/promises';
import load from '@babylonjs/havok';
import { serve, versionOf } from './protocol.mjs';

const FAR = 100;  // m, the size of a box
const wasm = new URL('node_modules/@babylonjs/havok/lib/esm/HavokPhysics.wasm', import.meta.url);
const hk = await load({ wasmBinary: await readFile(wasm) });

// What a call of Havok's returns: a result, and perhaps something with it.
function value([result, made]) {
  if (result !== hk.Result.RESULT_OK) throw new Error(`Havok returned ${result}`);
  return made;
}

function addBody(scene, shape, motion, at, rotation = [0, 0, 0, 1]) {
  hk.HP_Shape_SetMaterial(shape, [scene.friction, scene.friction, scene.restitution,
    hk.MaterialCombine.MAXIMUM, hk.MaterialCombine.MAXIMUM]);
  const body = value(hk.HP_Body_Create());
  hk.HP_Body_SetShape(body, shape);
  hk.HP_Body_SetMotionType(body, motion);
  hk.HP_Body_SetQTransform(body, [[...at, 0], rotation]);
  return body;
}

function make(scene, initial, h) {
  const world = value(hk.HP_World_Create());
  hk.HP_World_SetGravity(world, [...scene.gravity, 0]);
  hk.HP_World_SetIdealStepTime(world, h);
  const shapes = [];
  const bodies = initial.map(([x, y, vx, vy], i) => {
    const disc = scene.bodies[i];
    shapes.push(value(hk.HP_Shape_CreateSphere([0, 0, 0], disc.radius)));
    const body = addBody(scene, shapes.at(-1), disc.fixed ? hk.MotionType.STATIC : hk.MotionType.DYNAMIC, [x, y]);
    if (!disc.fixed) {
      hk.HP_Body_SetMassProperties(body, [[0, 0, 0], disc.mass, [0, 0, 0], [0, 0, 0, 1]]);  // it does not turn
      hk.HP_Body_SetLinearDamping(body, 0);
      hk.HP_Body_SetAngularDamping(body, 0);
      hk.HP_Body_SetLinearVelocity(body, [vx, vy, 0]);
      hk.HP_Body_SetActivationControl(body, hk.ActivationControl.ALWAYS_ACTIVE);
    }
    return body;
  });
  const grounds = scene.planes.map(({ point: [x, y], normal: [nx, ny] }) => {
    shapes.push(value(hk.HP_Shape_CreateBox([0, 0, 0], [0, 0, 0, 1], [FAR, FAR, FAR])));
    const half = Math.atan2(-nx, ny) / 2;
    return addBody(scene, shapes.at(-1), hk.MotionType.STATIC, [x - nx * FAR / 2, y - ny * FAR / 2],
      [0, 0, Math.sin(half), Math.cos(half)]);
  });
  const all = [...bodies, ...grounds];
  for (const body of all) hk.HP_World_AddBody(world, body, false);
  const position = (disc) => value(hk.HP_Body_GetPosition(bodies[disc]));
  return {
    push: (disc, fx, fy) => hk.HP_Body_ApplyImpulse(bodies[disc], position(disc), [fx * h, fy * h, 0]),
    step: () => hk.HP_World_Step(world, h),
    get: (disc) => [...position(disc).slice(0, 2), ...value(hk.HP_Body_GetLinearVelocity(bodies[disc])).slice(0, 2)],
    free: () => {
      for (const body of all) {
        hk.HP_World_RemoveBody(world, body);
        hk.HP_Body_Release(body);
      }
      shapes.forEach((shape) => hk.HP_Shape_Release(shape));
      hk.HP_World_Release(world);
    },
  };
}

await serve({ name: `Havok ${await versionOf('@babylonjs/havok')}`, make });
