// Lights a three.js scene (r155 or newer) live from Penumbra's daemon.
//
//   import { connect } from './penumbra_three.js';
//   const room = connect(THREE, scene, { url: 'http://127.0.0.1:8787' });   // later: room.close()
//
// three.js divides by pi in its surfaces (a white one sends E/pi), not in its lights:
//   LightProbe        takes the coefficients of radiance as they are. Its shader weights the bands
//                     by pi, 2pi/3 and pi/4, which makes them irradiance E. Its basis is ours.
//   DirectionalLight  intensity times colour is the irradiance E of a surface that faces it, so
//                     radiance times solid angle. No factor pi, unless useLegacyLights is true.
// Radiance is relative: `scale`, or renderer.toneMappingExposure, brings it to the scene's range.

const DISTANCE_M = 100; // only the direction matters, and where a shadow's camera stands

function place(light, found, scale) {
  const irradiance = found.radiance.map((c) => c * found.solid_angle_sr * scale);
  const most = Math.max(...irradiance);
  light.intensity = most;
  light.color.setRGB(...(most > 0 ? irradiance.map((c) => c / most) : [1, 1, 1])); // linear
  // It shines from its position towards its target, which stays in the origin.
  light.position.set(...found.direction).multiplyScalar(DISTANCE_M);
}

/**
 * Adds a LightProbe and one DirectionalLight for each distant light to `scene`, and follows them.
 * options: url of the daemon ('' is the page's own origin), rate_hz of updates, scale of radiance,
 *          on_light(light, state) after each update, for example to let a new light cast shadows
 * returns {probe, lights (Map by id), close()}; close() takes all of it away again.
 */
export function connect(THREE, scene, options = {}) {
  const { url = '', rate_hz = 10, scale = 1, on_light = null } = options;
  const probe = new THREE.LightProbe();
  const lights = new Map();
  scene.add(probe);

  const remove = (id) => {
    scene.remove(lights.get(id), lights.get(id).target);
    lights.get(id).dispose?.();
    lights.delete(id);
  };

  const update = (state) => {
    if (!state.light) return; // none measured yet: what was there stays
    const rows = state.light.residual.coefficients;
    // Nine coefficients, three bands; those that the daemon leaves out are zero.
    const sh = Array.from({ length: 9 }, (_, n) => rows[n] ?? [0, 0, 0]).flat();
    probe.sh.fromArray(sh.map((c) => c * scale));
    // Several lights that no camera sees share the id -1, so the place among equals counts, too.
    const seen = new Map();
    const found = new Map(state.light.lights.map((light) => {
      seen.set(light.id, (seen.get(light.id) ?? 0) + 1);
      return [`${light.id}/${seen.get(light.id)}`, light];
    }));
    for (const id of [...lights.keys()]) if (!found.has(id)) remove(id);
    for (const [id, light] of found) {
      if (!lights.has(id)) {
        lights.set(id, new THREE.DirectionalLight());
        scene.add(lights.get(id), lights.get(id).target);
      }
      place(lights.get(id), light, scale);
    }
    on_light?.(state.light, state);
  };

  // The browser connects again by itself when the daemon has gone and come back.
  const events = new EventSource(`${url}/v1/events?rate_hz=${rate_hz}`);
  events.addEventListener('state', (event) => update(JSON.parse(event.data)));
  const close = () => {
    events.close();
    for (const id of [...lights.keys()]) remove(id);
    scene.remove(probe);
  };
  return { probe, lights, close };
}
