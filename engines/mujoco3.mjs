// MuJoCo 3: discs as spheres on two slides, half-planes as planes. Contacts are springs as stiff as `solref` says, without
// damping, which bounce elastically; MuJoCo has no coefficient of restitution. --default takes its own solref.
import load from '@mujoco/mujoco';
import { argument, serve, versionOf } from './protocol.mjs';

const mujoco = await load();
const solref = argument('default') ? '' : "solref='-40000 0'";

// The scene as MuJoCo's XML.
function model(scene, initial, h) {
  const bodies = initial.map(([x, y], i) => {
    const disc = scene.bodies[i];
    const sphere = `<geom type='sphere' size='${disc.radius}' mass='${disc.mass}'`;
    return disc.fixed ? `${sphere} pos='${x} ${y} 0'/>`
      : `<body><joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 1 0'/>${sphere}/></body>`;
  });
  const planes = scene.planes.map(({ point, normal }) =>
    `<geom type='plane' size='0 0 1' pos='${point.join(' ')} 0' zaxis='${normal.join(' ')} 0'/>`);
  return `<mujoco><option timestep='${h}' gravity='${scene.gravity.join(' ')} 0'/>
    <default><geom ${solref} condim='${scene.friction > 0 ? 3 : 1}' friction='${scene.friction} 0 0'/></default>
    <worldbody>${bodies.join('')}${planes.join('')}</worldbody></mujoco>`;
}

function make(scene, initial, h) {
  const compiled = mujoco.MjModel.from_xml_string(model(scene, initial, h));
  const data = new mujoco.MjData(compiled);
  const slides = [];  // by disc: the index of its slide along x, that along y follows
  let next = 0;
  initial.forEach(([x, y, vx, vy], i) => {
    slides.push(next);
    if (scene.bodies[i].fixed) return;
    data.qpos.set([x, y], next);
    data.qvel.set([vx, vy], next);
    next += 2;
  });
  return {
    push: (disc, fx, fy) => data.qfrc_applied.set([fx, fy], slides[disc]),
    step: () => {
      mujoco.mj_step(compiled, data);
      data.qfrc_applied.fill(0);
    },
    get: (disc) => {
      const at = slides[disc];
      return [...data.qpos.subarray(at, at + 2), ...data.qvel.subarray(at, at + 2)];
    },
    free: () => {
      data.delete();
      compiled.delete();
    },
  };
}

const refusal = (scene) =>
  scene.restitution === 1 || !solref ? '' : 'MuJoCo has no coefficient of restitution: this driver\'s contacts are elastic';

await serve({ name: `MuJoCo ${await versionOf('@mujoco/mujoco')}${solref ? '' : ', default solref'}`, make, refusal });
