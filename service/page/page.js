// The daemon's page: what the service sees and does, and what can be changed of it.
const $ = (id) => document.getElementById(id);

// ---- Numbers in words. ----
const fixed = (x, digits) => x.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
const significant = (x) => fixed(x, Math.abs(x) < 0.0995 ? 3 : Math.abs(x) < 9.95 ? 2 : Math.abs(x) < 99.5 ? 1 : 0);
const percent = (x) => `${fixed(100 * x, x > 0 && x < 0.00995 ? 2 : x < 0.995 ? 1 : 0)} %`;
const count = (n, one, many = one + "s") => `${n.toLocaleString("en")} ${n === 1 ? one : many}`;
const degrees = (rad) => rad * 180 / Math.PI, radians = (deg) => deg * Math.PI / 180;
function duration(s) {
  if (s < 60) return `${Math.floor(s)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`;
  return `${Math.floor(s / 3600)} h ${Math.floor(s / 60) % 60} min`;
}
const exposure = (s) => s >= 1 ? `${significant(s)} s` : `${+(1000 * s).toPrecision(3)} ms`;
const luminance = ([r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b;

// ---- Vectors and the view camera. World right-handed, y up; the camera looks along its -z. ----
const add = (a, b) => a.map((x, i) => x + b[i]);
const sub = (a, b) => a.map((x, i) => x - b[i]);
const scale = (a, s) => a.map((x) => x * s);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scale(a, 1 / Math.hypot(...a));
function rotate([w, ...q], v) {
  const t = scale(cross(q, v), 2);
  return add(add(v, scale(t, w)), cross(q, t));
}
function cameraOf(view) {
  const q = view.world_from_camera.rotation_wxyz;
  return { ...view, eye: view.world_from_camera.translation_m,
    right: rotate(q, [1, 0, 0]), up: rotate(q, [0, 1, 0]), back: rotate(q, [0, 0, 1]) };
}
function rayThrough(camera, [u, v]) {
  const x = (u - camera.centre_px[0]) / camera.focal_px[0], y = (camera.centre_px[1] - v) / camera.focal_px[1];
  return unit(sub(add(scale(camera.right, x), scale(camera.up, y)), camera.back));
}
/** Pixel of a point; null behind the camera. */
function pixelOf(camera, point) {
  const d = sub(point, camera.eye), depth = -dot(d, camera.back);
  if (depth < 1e-3) return null;
  return [camera.centre_px[0] + camera.focal_px[0] * dot(d, camera.right) / depth,
    camera.centre_px[1] - camera.focal_px[1] * dot(d, camera.up) / depth];
}
/** Where a ray from the camera meets a plane; null if it does not, or so flatly that a pixel is a long way. */
function onPlane(camera, ray, point, normal, flattest = 0.02) {
  const along = dot(ray, normal), distance = dot(sub(point, camera.eye), normal) / along;
  return Math.abs(along) > flattest && distance > 0 ? add(camera.eye, scale(ray, distance)) : null;
}
/** Outline of a sphere in the picture: the circle in which rays touch it. Null if the camera cannot see all of it. */
function outlineOf(camera, centre, radius) {
  const to = sub(centre, camera.eye), distance = Math.hypot(...to);
  if (distance <= radius * 1.001) return null;
  const sine = radius / distance, axis = scale(to, 1 / distance);
  const middle = add(camera.eye, scale(to, 1 - sine * sine)), r = radius * Math.sqrt(1 - sine * sine);
  const a = unit(cross(axis, Math.abs(axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0])), b = cross(axis, a);
  const points = [];
  for (let i = 0; i < 64; ++i) {
    const t = i / 32 * Math.PI, at = add(scale(a, r * Math.cos(t)), scale(b, r * Math.sin(t)));
    points.push(pixelOf(camera, add(middle, at)));
  }
  return points.includes(null) ? null : points;
}

// ---- Document. ----
function setText(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}
function element(name, attributes = {}, ...children) {
  const isSvg = name === "path" || name === "text";
  const made = isSvg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
/** Replaces children only where the data changed, so that focus and selected text stay. */
function setRows(parent, rows, make) {
  const key = JSON.stringify(rows);
  if (parent.dataset.key === key) return;
  parent.dataset.key = key;
  parent.replaceChildren(...rows.map(make));
}
function say(text, isFault = false) {
  $("said").classList.toggle("fault", isFault);
  setText("said", text);
}

// ---- Requests. ----
async function ask(method, path, body) {
  const options = { method, signal: AbortSignal.timeout(5000) };
  if (body) Object.assign(options, { headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  let reply;
  try {
    reply = await fetch(path, options);
  } catch {
    throw new Error("The service did not answer; nothing was changed");
  }
  const answer = await reply.json().catch(() => ({}));
  if (!reply.ok) throw new Error(answer.error ?? `${path}: status ${reply.status}`);
  return answer;
}

// ---- Objects: what the service told of them, and what it has been asked since. ----
let camera = null, state = null, objects = [], selected = null, hovered = null;
const unsent = new Map();  // by object: newest wins
const asked = new Map();   // by object: shown until the service's own answer has caught up
const speeds = new Map();  // the service does not tell them
let isSending = false;

function shownObjects() {
  return objects.map((o) => {
    const own = asked.get(o.name);
    if (!own || own.until < performance.now()) return o;
    const by = sub(own.body.position_m ?? o.position_m, o.position_m);
    return { ...o, ...own.body, centre_m: add(o.centre_m, by), height_m: o.height_m + dot(by, o.normal) };
  });
}
const objectNamed = (name) => shownObjects().find((o) => o.name === name);

function change(name, body) {
  unsent.set(name, { ...unsent.get(name), ...body });
  const own = asked.get(name);
  asked.set(name, { until: Infinity, body: own && own.until > performance.now() ? { ...own.body, ...body } : body });
  showObjects();
  send();
}
async function send() {
  if (isSending) return;
  isSending = true;
  while (unsent.size) {
    const [name, body] = unsent.entries().next().value;
    unsent.delete(name);
    try {
      objects = (await ask("PATCH", `/v1/objects/${encodeURIComponent(name)}`, body)).objects;
      if ($("said").classList.contains("fault")) say("");
      if ("speed" in body) speeds.set(name, body.speed);
      // A state that was on its way may be older than the answer.
      if (!unsent.has(name)) asked.get(name).until = performance.now() + 500;
    } catch (error) {
      unsent.delete(name);
      asked.delete(name);
      say(error.message, true);
    }
    showObjects();
  }
  isSending = false;
}
/** Along the plane, seen from the camera: x to the right, y away. */
function moveBy(o, x, y) {
  const right = camera ? camera.right : [1, 0, 0], flat = sub(right, scale(o.normal, dot(right, o.normal)));
  if (Math.hypot(...flat) < 0.01) return;
  const across = unit(flat), away = cross(o.normal, across);
  change(o.name, { position_m: add(o.position_m, add(scale(across, x), scale(away, y))) });
}
/** Its direction forward when it is turned further. */
function turned(o, deg) {
  const side = cross(o.normal, o.forward), by = radians(deg);
  return add(scale(o.forward, Math.cos(by)), scale(side, Math.sin(by)));
}
/** In degrees, the way that the camera looks; what it leans already counts. */
function leanBy(o, deg) {
  const look = camera ? cross(o.normal, camera.right) : o.forward, side = cross(o.normal, o.forward);
  const to = Math.atan2(dot(look, side), dot(look, o.forward)), from = radians(o.lean_towards_deg);
  const x = o.lean_deg * Math.sin(from) + deg * Math.sin(to), z = o.lean_deg * Math.cos(from) + deg * Math.cos(to);
  change(o.name, { lean_deg: Math.hypot(x, z), lean_towards_deg: degrees(Math.atan2(x, z)) });
}
const liftedBy = (o, m) => add(o.position_m, scale(o.normal, Math.max(m, -o.height_m)));
const liftBy = (o, m) => o.lifts && change(o.name, { position_m: liftedBy(o, m) });
const turnBy = (o, deg) => change(o.name, { turn_deg: ((o.turn_deg + deg + 180) % 360 + 360) % 360 - 180 });
const speedOf = (o) => o.speed ?? speeds.get(o.name) ?? 1;
const acts = {
  left: (o) => turnBy(o, 15),
  right: (o) => turnBy(o, -15),
  lift: (o) => liftBy(o, 0.05),
  lower: (o) => liftBy(o, -0.05),
  upright: (o) => o.lifts && change(o.name, { lean_deg: 0, position_m: liftedBy(o, -o.height_m) }),
  visible: (o) => change(o.name, { visible: !o.visible }),
  play: (o) => o.plays && change(o.name, { speed: speedOf(o) ? 0 : 1 }),
};
function select(name) {
  selected = name;
  showObjects();
}

function showObjects() {
  const all = shownObjects();
  if (selected && !all.some((o) => o.name === selected)) selected = null;
  setRows($("objects"), all.map((o) => o.name), (name) => {
    const button = element("button", { type: "button", "data-object": name }, name);
    button.addEventListener("click", () => select(name));
    return button;
  });
  for (const button of $("objects").children) {
    const o = all.find((each) => each.name === button.dataset.object);
    button.setAttribute("aria-pressed", String(o.name === selected));
    button.classList.toggle("away", !o.visible);
    const label = o.visible ? o.name : `${o.name}, hidden`;
    if (button.textContent !== label) button.textContent = label;
  }
  $("no-objects").hidden = all.length > 0;
  const o = all.find((each) => each.name === selected);
  $("selected").hidden = !o;
  if (o) {
    const at = o.position_m.map((x, i) => `${"xyz"[i]} ${fixed(x, 2)}`).join(", ");
    const height = o.height_m, lean = Math.abs(o.lean_deg);
    setText("place", `${o.name} at ${at} m, turned ${fixed(o.turn_deg, 0)}°`
      + (height > 0.01 ? `, lifted ${fixed(100 * height, 0)} cm` : "") + (lean > 0.5 ? `, leaning ${fixed(lean, 0)}°` : ""));
    const button = (act) => document.querySelector(`[data-act=${act}]`);
    for (const act of ["lift", "lower"]) button(act).hidden = !o.lifts;
    button("upright").hidden = height < 0.01 && lean < 0.5;
    button("visible").textContent = o.visible ? "Hide" : "Show";
    button("play").hidden = !o.plays;
    button("play").textContent = speedOf(o) ? "Rest" : "Play";
  }
  drawOverlay(all);
}
function drawOverlay(all) {
  const paths = [];
  for (const o of all) {
    const outline = (o.name === selected || o.name === hovered) && camera && outlineOf(camera, o.centre_m, o.radius_m);
    if (!outline) continue;
    const d = `M${outline.map((p) => p.map((x) => x.toFixed(1)).join(" ")).join("L")}Z`;
    const kind = !o.visible ? "away" : o.name === selected ? "selected" : "hovered";
    paths.push(element("path", { d, class: "under" }), element("path", { d, class: kind, "data-outline": o.name }));
  }
  $("overlay").replaceChildren(...paths);
}

// ---- Pointer on the picture. ----
let drag = null, hasDragged = false;
function pixelUnder(event) {
  const box = $("stage").getBoundingClientRect();
  const across = (event.clientX - box.left) / box.width, down = (event.clientY - box.top) / box.height;
  return [camera.width * across, camera.height * down];
}
/** Of the visible objects the one whose middle is nearest, in radii: bounding spheres overlap. */
function objectAt(event) {
  if (!camera) return null;
  const ray = rayThrough(camera, pixelUnder(event));
  let found = null, nearest = 1;
  for (const o of shownObjects()) {
    const to = sub(o.centre_m, camera.eye), along = dot(to, ray);
    const off = Math.hypot(...sub(to, scale(ray, along))) / o.radius_m;
    if (o.visible && along > 0 && off < nearest) [found, nearest] = [o, off];
  }
  return found;
}
/** The point that is held keeps under the pointer. Where its plane is seen too flatly, the object's foot is led. */
function gripOf(o, pixel) {
  const ray = rayThrough(camera, pixel), to = sub(o.centre_m, camera.eye), along = dot(to, ray);
  const deep = o.radius_m ** 2 - (dot(to, to) - along * along);
  const point = add(camera.eye, scale(ray, along - Math.sqrt(Math.max(0, deep)) * 0.5));
  if (Math.abs(dot(ray, o.normal)) > 0.12) return { point, offset: [0, 0] };
  const foot = pixelOf(camera, o.position_m);
  return { point: o.position_m, offset: foot ? sub(foot, pixel) : [0, 0] };
}
function pointerDown(event) {
  const o = objectAt(event);
  hasDragged = false;
  if (drag || !o) return;
  select(o.name);
  const pixel = pixelUnder(event), turns = event.shiftKey || event.button === 2;
  if (event.button === 1) return;
  drag = { id: event.pointerId, name: o.name, start: [event.clientX, event.clientY], turns, moved: false, from: o,
    ...gripOf(o, pixel) };
  $("stage").setPointerCapture(event.pointerId);
}
function pointerMove(event) {
  if (!drag) {
    const under = event.pointerType === "touch" ? null : objectAt(event)?.name ?? null;
    $("stage").classList.toggle("on-object", under !== null);
    if (under !== hovered) {
      hovered = under;
      drawOverlay(shownObjects());
    }
    return;
  }
  if (event.pointerId !== drag.id || !camera) return;
  const by = sub([event.clientX, event.clientY], drag.start);
  drag.moved ||= Math.hypot(...by) > (event.pointerType === "touch" ? 8 : 3);
  if (!drag.moved) return;
  $("stage").classList.add("dragging");
  if (drag.turns) {
    turnBy(drag.from, by[0] * 0.5);
    const beyond = Math.sign(by[1]) * Math.max(0, Math.abs(by[1]) - 10);
    if (drag.from.lifts) leanBy({ ...drag.from, forward: turned(drag.from, by[0] * 0.5) }, beyond * -0.5);
    return;
  }
  const to = onPlane(camera, rayThrough(camera, add(pixelUnder(event), drag.offset)), drag.point, drag.from.normal);
  if (to) change(drag.name, { position_m: add(drag.from.position_m, sub(to, drag.point)) });
}
function pointerUp(event) {
  if (drag?.id !== event.pointerId) return;
  hasDragged = drag.moved;
  drag = null;
  $("stage").classList.remove("dragging");
}
function wheel(event) {
  const o = objectAt(event);
  if (!o || o.name !== selected || event.ctrlKey) return;
  event.preventDefault();
  turnBy(o, -event.deltaY * (event.deltaMode ? 4 : 0.1));
}
function listenToPointer() {
  const stage = $("stage");
  stage.addEventListener("pointerdown", pointerDown);
  stage.addEventListener("pointermove", pointerMove);
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, pointerUp);
  stage.addEventListener("pointerleave", () => {
    hovered = null;
    drawOverlay(shownObjects());
  });
  stage.addEventListener("click", (event) => hasDragged || objectAt(event) || select(null));
  stage.addEventListener("contextmenu", (event) => objectAt(event) && event.preventDefault());
  stage.addEventListener("wheel", wheel, { passive: false });
  // A finger on an object drags it; beside one it scrolls the page.
  stage.addEventListener("touchstart", (event) => {
    if (event.touches.length === 1 && objectAt(event.touches[0])) event.preventDefault();
  }, { passive: false });
}

// ---- Keys. ----
function keyDown(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input, summary")) return;
  const o = objectNamed(selected), button = event.target.closest("button");
  const step = event.shiftKey ? 0.1 : 0.01, turn = event.shiftKey ? 45 : 5;
  const keys = {
    ArrowLeft: () => moveBy(o, -step, 0), ArrowRight: () => moveBy(o, step, 0),
    ArrowUp: () => moveBy(o, 0, step), ArrowDown: () => moveBy(o, 0, -step),
    PageUp: () => acts.lift(o), PageDown: () => acts.lower(o), Home: () => acts.upright(o),
    r: () => o.lifts && leanBy(o, turn), f: () => o.lifts && leanBy(o, -turn),
    q: () => turnBy(o, turn), "[": () => turnBy(o, turn), "{": () => turnBy(o, turn),
    e: () => turnBy(o, -turn), "]": () => turnBy(o, -turn), "}": () => turnBy(o, -turn),
    v: () => acts.visible(o), Escape: () => select(null),
    // A button keeps its own space, but that of the selected object has nothing else to do.
    " ": !button || button.dataset.object === selected ? () => acts.play(o) : undefined,
  };
  const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!o || !act) return;
  event.preventDefault();
  act();
}
function listenToKeys() {
  $("live").addEventListener("keydown", keyDown);
  for (const button of document.querySelectorAll("[data-act]"))
    button.addEventListener("click", () => objectNamed(selected) && acts[button.dataset.act](objectNamed(selected)));
}

// ---- Light. ----
const wordsOf = (l) => [l.id < 0 && "a sun that no camera sees", l.clipped && "clipped", l.recovered && "recovered",
  l.lower_bound && "lower bound"].filter(Boolean).join(", ");

/** Edge of a cone of directions in a lat-long map of w by h; open if a pole is in it. */
function coneOnMap([x, y, z], radius, w, h) {
  const axis = [x, y, z], a = unit(cross(axis, Math.abs(y) < 0.9 ? [0, 1, 0] : [1, 0, 0])), b = cross(axis, a);
  const points = [];
  let before = Math.atan2(x, -z);
  for (let i = 0; i <= 72; ++i) {
    const t = i / 36 * Math.PI, out = add(scale(a, Math.cos(t)), scale(b, Math.sin(t)));
    const d = add(scale(axis, Math.cos(radius)), scale(out, Math.sin(radius)));
    const azimuth = Math.atan2(d[0], -d[2]);
    before = azimuth + 2 * Math.PI * Math.round((before - azimuth) / 2 / Math.PI);
    points.push([(before / 2 / Math.PI + 0.5) * w, Math.acos(Math.max(-1, Math.min(1, d[1]))) / Math.PI * h]);
  }
  return points;
}
function drawLights(light) {
  const svg = $("lights"), w = svg.clientWidth, h = svg.clientHeight, shapes = [];
  svg.setAttribute("viewBox", `0 0 ${w} ${h}`);
  for (const l of light?.lights ?? []) {
    const points = coneOnMap(l.direction, Math.max(l.radius_rad, 4 * Math.PI / h), w, h);
    for (const shift of [-w, 0, w]) {  // over the edge it comes back on the other side
      const d = `M${points.map((p) => `${(p[0] + shift).toFixed(1)} ${p[1].toFixed(1)}`).join("L")}`;
      shapes.push(element("path", { d, class: "under" }), element("path", { d }));
    }
    const at = [(Math.atan2(l.direction[0], -l.direction[2]) / 2 / Math.PI + 0.5) * w,
      Math.acos(Math.max(-1, Math.min(1, l.direction[1]))) / Math.PI * h];
    const radius = l.radius_rad / Math.PI * h, words = wordsOf(l);
    shapes.push(element("text", { x: Math.max(0.12 * w, Math.min(0.88 * w, at[0])), "text-anchor": "middle",
      y: radius > 14 ? at[1] + 4 : Math.min(at[1] + radius + 18, h - 4) }, words ? `${l.id} ${words}` : `${l.id}`));
  }
  svg.replaceChildren(...shapes);
}
function showLight(light) {
  const stale = state.status === "stale";
  setText("age", light ? `${significant(light.age_s)} s${stale ? ", stale" : ""}` : "no light yet");
  $("age").classList.toggle("fault", stale);
  setText("coverage", light ? percent(light.coverage) : "–");
  const uncertain = light?.uncertainty;
  setText("uncertainty", !uncertain ? "–" : uncertain.irradiance === null ? "unknown, a light is a lower bound"
    : `± ${percent(uncertain.irradiance)}`);
  setText("clipped", light ? percent(light.clipped_fraction) : "–");
  setText("mean", light ? light.mean_radiance.map(significant).join(" ") : "–");
  drawLights(light);
  const modelled = light?.plan?.lights ?? Infinity;
  const rows = (light?.lights ?? []).map((l, i) => {
    const up = degrees(Math.asin(Math.max(-1, Math.min(1, l.direction[1]))));
    const about = degrees(Math.atan2(l.direction[0], -l.direction[2]));
    const words = [wordsOf(l), i >= modelled && "not modelled"].filter(Boolean).join(", ");
    return `${l.id}: ${fixed(Math.abs(up), 0)}° ${up < 0 ? "down" : "up"}, azimuth ${fixed(about, 0)}°, ` +
      `radius ${fixed(degrees(l.radius_rad), 1)}°, radiance ${significant(luminance(l.radiance))}` +
      (words ? `; ${words}` : "");
  });
  setRows($("light-list"), rows.length ? rows : ["none"], (row) => element("li", {}, row));
}
/** Irradiance of a unit normal by up to three bands, over pi: what a white matt ball sends out. */
function ballRadiance(terms, [x, y, z]) {
  const basis = [0.282095, 0.325735 * y, 0.325735 * z, 0.325735 * x, 0.273137 * x * y, 0.273137 * y * z,
    0.078848 * (3 * z * z - 1), 0.273137 * x * z, 0.136569 * (x * x - y * y)];  // times A_l / pi
  const out = [0, 0, 0];
  terms.forEach((term, i) => term.forEach((value, c) => { out[c] += value * basis[i]; }));
  return out;
}
const toSrgb = (x) => 255 * (x <= 0.0031308 ? 12.92 * Math.max(0, x) : 1.055 * Math.min(1, x) ** (1 / 2.4) - 0.055);
function drawBall(light) {
  const canvas = $("ball"), size = Math.min(320, Math.round(canvas.clientWidth * devicePixelRatio));
  const terms = light.coefficients.slice(0, 9), { right, up, back } = camera ??
    { right: [1, 0, 0], up: [0, 1, 0], back: [0, 0, 1] };
  const key = JSON.stringify([size, terms, right, up, light.mean_radiance]);
  if (canvas.dataset.key === key || !size) return;
  canvas.dataset.key = key;
  canvas.width = canvas.height = size;
  const context = canvas.getContext("2d"), picture = context.createImageData(size, size), half = size / 2;
  const gain = 0.3 / Math.max(1e-9, luminance(light.mean_radiance));
  for (let i = 0, at = 0; i < size * size; ++i, at += 4) {
    const x = (i % size + 0.5) / half - 1, y = 1 - (Math.floor(i / size) + 0.5) / half, r = Math.hypot(x, y);
    const inside = Math.min(1, (1 - r) * half + 0.5);
    if (inside <= 0) continue;
    const n = unit(add(add(scale(right, x), scale(up, y)), scale(back, Math.sqrt(Math.max(0, 1 - r * r)))));
    ballRadiance(terms, n).forEach((value, c) => { picture.data[at + c] = toSrgb(gain * value); });
    picture.data[at + 3] = 255 * inside;
  }
  context.putImageData(picture, 0, 0);
}

// ---- Plots. ----
function surface(canvas) {
  const w = canvas.clientWidth, h = canvas.clientHeight, c = canvas.getContext("2d");
  canvas.width = Math.round(w * devicePixelRatio);
  canvas.height = Math.round(h * devicePixelRatio);
  c.scale(devicePixelRatio, devicePixelRatio);
  c.font = "12px system-ui, sans-serif";
  const style = getComputedStyle(document.documentElement);
  return { c, w, h, colour: (name) => style.getPropertyValue(`--${name}`) };
}
function niceStep(range, parts) {
  const raw = range / parts, ten = 10 ** Math.floor(Math.log10(raw));
  return ten * [1, 2, 5, 10].find((m) => m * ten >= raw * 0.999);
}
/** Grid and labels of a plot from zero up. Returns where a value stands. */
function drawScale({ c, w, h, colour }, top, left, foot, head = 22) {
  const step = niceStep(top, 3), end = step * Math.ceil(top / step - 1e-9);
  const y = (value) => h - foot - (h - foot - head) * value / end;
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  c.textAlign = "right";
  for (let value = 0; value <= end * 1.001; value += step) {
    c.fillStyle = colour("grid");
    c.fillRect(left, Math.round(y(value)), w - left, 1);
    c.fillStyle = colour("quiet");
    c.fillText(value.toFixed(digits), left - 6, y(value) + 4);
  }
  return y;
}
const kMinutes = 5, history = [];
let histogram = null;
/** Where the names of lines stand, in as many rows as they need. */
function legendPlaces({ c, w }, names, left) {
  let x = left, y = 8;
  return names.map((name) => {
    const wide = 23 + c.measureText(name).width;
    if (x > left && x + wide > w) x = left, y += 15;
    const place = { x, y };
    x += wide + 12;
    return place;
  });
}
/** lines: [{name, of: (sample) => number or null}], the newest sample at the right. */
function plot(id, lines, words) {
  const area = surface($(id)), { c, w, h, colour } = area, now = performance.now(), left = 40, foot = 20;
  const known = lines.flatMap((line) => history.map(line.of).filter((v) => v != null));
  const legend = legendPlaces(area, lines.map((line) => line.name), left);
  const y = drawScale(area, known.length ? Math.max(...known, 0.01) * 1.05 : 1, left, foot, legend.at(-1).y + 14);
  const x = (t) => w - 4 - (w - left - 4) * (now - t) / (kMinutes * 60000);
  c.fillStyle = colour("quiet");
  for (const minute of [4, 2, 0]) {
    c.textAlign = minute ? "center" : "right";
    c.fillText(minute ? `−${minute} min` : "now", x(now - minute * 60000), h - 4);
  }
  lines.forEach((line, i) => {
    c.strokeStyle = colour(`series-${i + 1}`);
    c.lineWidth = 1.75;
    c.setLineDash([[], [6, 3], [2, 3]][i]);
    c.beginPath();
    let before = -Infinity;  // no line over a time in which nothing was heard
    for (const sample of history) {
      const value = line.of(sample);
      if (value == null) continue;
      c[sample.t - before < 3500 ? "lineTo" : "moveTo"](x(sample.t), y(value));
      before = sample.t;
    }
    if (lines.length > 1) {
      const at = legend[i];
      c.moveTo(at.x, at.y);
      c.lineTo(at.x + 18, at.y);
      c.fillStyle = colour("ink");
      c.textAlign = "left";
      c.fillText(line.name, at.x + 23, at.y + 4);
    }
    c.stroke();
  });
  if (!known.length) {
    c.textAlign = "center";
    c.fillText("nothing yet", (left + w) / 2, h / 2);
  }
  $(id).setAttribute("aria-label", words);
}
function drawPlots() {
  const last = history.at(-1);
  if (!last) return;
  const slowest = Object.entries(last.stages).sort((a, b) => b[1] - a[1]).slice(0, 3).map(([name]) => name);
  const now = (value, unitName) => value == null ? "unknown now" : `${significant(value)} ${unitName} now`;
  plot("plot-rate", [{ of: (s) => s.rate }], `Frame rate: ${now(last.rate, "per second")}`);
  plot("plot-stages", slowest.map((name) => ({ name, of: (s) => s.stages[name] })),
    `Slowest stages: ${slowest.map((name) => `${name} ${now(last.stages[name], "ms")}`).join(", ")}`);
  plot("plot-error", [{ name: "predicted", of: (s) => s.error }, { name: "budget", of: (s) => s.budget }],
    `Predicted error: ${now(last.error, "%")}, budget ${significant(last.budget)} %`);
  plot("plot-age", [{ of: (s) => s.age }], `Age of the light: ${now(last.age, "s")}`);
}
function drawCanvases() {
  drawPlots();
  drawHistogram();
  if (state?.light) drawBall(state.light);
}
function drawHistogram() {
  if (!histogram) return;
  const { first_log2: first, step_log2: step, fraction } = histogram;
  const area = surface($("histogram")), { c, w, h, colour } = area, left = 34, foot = 20;
  const top = Math.max(...fraction, 0.01), y = drawScale(area, 100 * top, left, foot);
  c.textAlign = "left";
  c.fillText("%", left + 2, 12);
  const wide = (w - left) / fraction.length, every = Math.ceil(28 / wide);
  fraction.forEach((part, i) => {
    c.fillStyle = colour("series-1");
    const high = part > 0 ? Math.max(1, y(0) - y(100 * part)) : 0;
    c.fillRect(left + i * wide + 1, y(0) - high, Math.max(1, wide - 2), high);
    c.fillStyle = colour("quiet");
    c.textAlign = "center";
    if (i % every === 0 && i > 0) c.fillText(fixed(first + i * step, step < 1 ? 1 : 0), left + i * wide, h - 4);
  });
  const most = fraction.indexOf(Math.max(...fraction));
  $("histogram").setAttribute("aria-label", `Histogram of the environment: most of it, ${percent(fraction[most])}, ` +
    `is at a luminance of 2 to the ${fixed(first + most * step, 1)}`);
}

// ---- What the service does. ----
function showPlan(light, budget) {
  const plan = light?.plan;
  if (!plan) return;
  const step = plan.map_step;
  const block = step > 1 ? `map in blocks of ${step}\u00a0×\u00a0${step}\u00a0px` : "map as it is";
  setText("modelled", `${count(plan.bands, "band")} (${count(plan.bands ** 2, "coefficient")}), ${plan.lights} of ` +
    `${count(light.lights.length, "distant light")}, ${plan.fine_lights} with fine shadows; ${block}`);
  const less = [plan.bands < light.bands && count(light.bands - plan.bands, "band"),
    plan.lights < light.lights.length && count(light.lights.length - plan.lights, "light"),
    plan.map_step > 1 && "detail of the map",
    plan.time_limited && "distant lights that a frame has no time for"].filter(Boolean).join(", ");
  setText("given-up", less || "nothing");
  const errors = { error: plan.predicted_error, "object-error": plan.predicted_object_error };
  for (const [id, value] of Object.entries(errors)) {
    const over = value == null || value > budget;
    setText(id, value == null ? "unknown, at least what was measured: a light is saturated in every exposure"
      : `${percent(value)}, ${over ? "over" : "within"} the budget of ${percent(budget)}`);
    $(id).classList.toggle("fault", over);
  }
  setText("cost", `${significant(plan.predicted_ms)} ms: map ${significant(plan.reading_ms)}, harmonics ` +
    `${significant(plan.relighting_ms)}, lights ${significant(plan.lights_ms)}`);
  setText("why", plan.why);
}
function showStages(stages) {
  const rows = Object.entries(stages).sort((a, b) => b[1].p50_ms - a[1].p50_ms);
  const most = Math.max(...rows.map(([, s]) => s.p99_ms), 1e-9);
  setRows($("stage-rows"), rows, ([name, s]) => {
    const bars = [s.p50_ms, s.p99_ms].map((ms) => {
      const bar = element("i");
      bar.style.width = `${100 * ms / most}%`;
      return bar;
    });
    return element("tr", {}, element("th", { scope: "row" }, name),
      element("td", { class: "number" }, significant(s.p50_ms)),
      element("td", { class: "number" }, significant(s.p99_ms)),
      element("td", { class: "number" }, s.count.toLocaleString("en")),
      element("td", { class: "wide", "aria-hidden": "true" }, element("div", { class: "bar" }, ...bars)));
  });
}
function faultsOf(c) {
  return [c.follows_exposure === false && "does not follow its exposure", c.lost && `${c.lost} lost`,
    c.damaged && `${c.damaged} damaged`, c.rejected && `${c.rejected} with another exposure`,
    c.overrun && `${c.overrun} overrun`, c.reconnected && `came back ${count(c.reconnected, "time")}`].filter(Boolean);
}
function showCameras(cameras) {
  const rows = Object.entries(cameras);
  $("no-cameras").hidden = rows.length > 0;
  $("camera-table").hidden = rows.length === 0;
  setRows($("camera-rows"), rows, ([name, c]) => {
    const gain = (i) => (c.gains[i] ?? 1) === 1 ? "" : ` × ${+c.gains[i].toPrecision(3)}`;
    const times = c.exposures_s.map((s, i) => exposure(s) + gain(i));
    const faults = faultsOf(c), left = c.light_error == null ? "" : `; error of the light ${percent(c.light_error)}`;
    return element("tr", {}, element("th", { scope: "row", "data-label": "Camera" }, name),
      element("td", { class: "number", "data-label": "Frames" }, c.frames.toLocaleString("en")),
      element("td", { "data-label": "Exposures" }, times.join(", ") + left),
      element("td", { "data-label": "Delay" }, c.delay_frames == null ? "not known" : count(c.delay_frames, "frame")),
      element("td", { "data-label": "Faults", class: faults.length ? "fault" : "" },
        faults.length ? `⚠ ${faults.join(", ")}` : "none"));
  });
}
function showPreparing(preparing) {
  const names = Object.keys(preparing);
  setRows($("preparing"), names, (name) => element("label", {}, `Preparing ${name}`,
    element("progress", { max: "1" }), element("span")));
  [...$("preparing").children].forEach((label, i) => {
    label.children[0].value = preparing[names[i]];
    label.children[1].textContent = percent(preparing[names[i]]);
  });
}
function showMissing(faults) {
  setRows($("missing"), Object.entries(faults), ([name, reason]) => element("p", { class: "fault" }, `⚠ ${name}: ${reason}`));
}
// The service goes on telling of the last recording when it has ended.
function showRecording(recording) {
  const goesOn = Boolean(recording?.active);
  setText("record-button", goesOn ? "Stop recording" : "Record");
  $("file").disabled = $("recorded-light").disabled = goesOn;
  setText("recording", recording ? `${recording.file}: ${duration(recording.seconds)}, ` +
    `${count(recording.frames, "frame")}, ${significant(recording.bytes / 1e6)} MB` +
    (recording.dropped ? `, ${recording.dropped} dropped` : "") : "");
  setText("recording-fault", recording?.error ? `⚠ ${recording.error}` : "");
}
function showHeader() {
  setText("status", state.status);
  $("status").classList.toggle("bad", state.status === "stale");
  setText("version", state.version);
  setText("uptime", duration(state.uptime_s));
  setText("frames", state.frames.toLocaleString("en"));
  setText("rate", `${fixed(state.frame_rate_hz, 1)} frames/s`);
  setText("dropped", `${count(state.dropped.view, "view frame")}, ${state.dropped.environment} of the environment` +
    (state.dropped.foreground ? `, ${state.dropped.foreground} of depth or masks` : ""));
}
function show(newest) {
  state = newest;
  objects = state.objects ?? [];
  showHeader();
  showObjects();
  showPreparing(state.preparing ?? {});
  showMissing(state.faults ?? {});
  setText("no-objects", Object.keys(state.preparing ?? {}).length ? "Objects are being prepared" : "No objects yet");
  showLight(state.light);
  showPlan(state.light, state.budget.max_shadow_error);
  showRecording(state.recording);
  if (document.activeElement !== $("budget")) $("budget").value = +(100 * state.budget.max_shadow_error).toPrecision(4);
  if (!hasPicture && state.frames > 0) startPicture();
}

// ---- What comes once a second: plots, tables, and what the state does not bring. ----
let sceneAsked = false, mapTime = null, mapAsked = false;
async function fetchScene() {
  if (sceneAsked) return;
  sceneAsked = true;
  try {
    const { view } = await ask("GET", "/v1/scene");
    camera = view && cameraOf(view);
    if (view) {
      $("stage").style.setProperty("--ratio", view.width / view.height);
      $("overlay").setAttribute("viewBox", `0 0 ${view.width} ${view.height}`);
    }
  } catch { /* the next second asks again */ }
  sceneAsked = false;
}
async function fetchEnvironment() {
  if (mapAsked || !state.light || state.light.time_ns === mapTime) return;
  mapAsked = true;
  try {
    const [told, reply] = await Promise.all([ask("GET", "/v1/environment"), fetch("/v1/environment.jpg")]);
    if (reply.ok) {
      const old = $("environment").src;
      $("environment").src = URL.createObjectURL(await reply.blob());
      await $("environment").decode();
      if (old) URL.revokeObjectURL(old);
      $("no-map").hidden = true;
      mapTime = state.light.time_ns;
    }
    histogram = told.histogram;
    drawHistogram();
  } catch { /* the next second asks again */ }
  mapAsked = false;
}
function everySecond() {
  if (document.hidden) return;
  if (link.source.readyState !== EventSource.CLOSED && performance.now() - link.heardAt > 4000) lose();
  if (link.lostAt !== null) setText("lost-since", ` since ${duration((performance.now() - link.lostAt) / 1000)}`);
  if (link.lostAt !== null || !state) return;
  const { light, stages, frame_rate_hz: rate, budget } = state, error = light?.plan?.predicted_error;
  const sample = { t: performance.now(), rate, age: light?.age_s, budget: 100 * budget.max_shadow_error,
    error: error == null ? null : 100 * error, stages: {} };
  for (const [name, s] of Object.entries(stages)) sample.stages[name] = s.p99_ms;
  history.push(sample);
  while (history[0].t < sample.t - kMinutes * 60000) history.shift();
  // A stream that ends before its first picture is no error to the browser.
  if (!$("picture").naturalWidth && performance.now() - pictureAsked > 3000) hasPicture = false;
  drawCanvases();
  showStages(stages);
  showCameras(state.cameras);
  fetchScene();
  if (history.length % 2) fetchEnvironment();
}

// ---- The service comes and goes. ----
const link = { source: null, lostAt: null, heardAt: 0, tries: 0, timer: 0 };
let hasPicture = false, pictures = 0, pictureAsked = 0;
function startPicture() {
  hasPicture = true;
  pictureAsked = performance.now();
  $("picture").src = `/v1/frame.mjpeg?${++pictures}`;
  $("no-picture").hidden = true;
}
function hear(newest) {
  link.heardAt = performance.now();
  link.tries = 0;
  if (link.lostAt !== null) {
    link.lostAt = null;
    $("lost").hidden = true;
    document.body.classList.remove("lost");
    say(state && state.version !== newest.version
      ? `The service is version ${newest.version} now; reload the page` : "The service answers again");
    hasPicture = false;
    mapTime = null;
    fetchScene();
  }
  show(newest);
}
function connect() {
  link.heardAt = performance.now();
  link.source?.close();
  link.source = new EventSource("/v1/events?rate_hz=4");
  link.source.addEventListener("state", (event) => hear(JSON.parse(event.data)));
  link.source.addEventListener("error", lose);
}
function lose() {
  link.source.close();
  clearTimeout(link.timer);
  if (document.hidden) return;
  link.lostAt ??= link.heardAt;
  link.timer = setTimeout(connect, Math.min(5000, 500 * 2 ** link.tries++));
  document.body.classList.add("lost");
  setText("status", "no answer");
  $("status").classList.add("bad");
  $("lost").hidden = false;
  // An event source does not tell why it failed.
  fetch("/healthz", { signal: AbortSignal.timeout(2000) }).then(() => true, () => false).then((answers) => {
    setText("lost-text", answers ? "The service answers but sends no events; too many pages may be open"
      : "The service does not answer");
  });
}
function leave() {
  link.source?.close();
  clearTimeout(link.timer);
  hasPicture = false;
  $("picture").removeAttribute("src");
}

// ---- Buttons. ----
async function press(button, request, done) {
  button.disabled = true;
  try {
    say(done(await request()));
  } catch (error) {
    say(error.message, true);
  }
  button.disabled = false;
}
function listenToButtons() {
  $("record").addEventListener("submit", (event) => {
    event.preventDefault();
    const file = $("file").value.trim(), light = $("recorded-light").value,
      stops = Boolean(state?.recording?.active);
    if (stops) press($("record-button"), () => ask("DELETE", "/v1/recording"), () => "Recording stopped");
    else press($("record-button"), () => ask("POST", "/v1/recording", { light, ...(file && { file }) }), () => "Recording");
  });
  $("snapshot").addEventListener("click", () =>
    press($("snapshot"), () => ask("POST", "/v1/snapshot", {}), ({ file }) => `Saved ${file}`));
  $("budget-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const value = $("budget").valueAsNumber / 100;
    press(event.submitter ?? $("budget"), () => ask("PATCH", "/v1/budget", { max_shadow_error: value }),
      () => `The error budget is ${percent(value)}`);
  });
  $("picture").addEventListener("error", () => {
    $("picture").removeAttribute("src");
    $("no-picture").hidden = false;
    setTimeout(() => { hasPicture = false; }, 1000);
  });
}
async function copy(code, button) {
  try {
    await navigator.clipboard.writeText(code.textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  } catch {
    getSelection().selectAllChildren(code);
    button.textContent = "Selected";
  }
}
function showAddresses() {
  const addresses = [["OBS: media source, not a local file", "/v1/frame.mjpeg"],
    ["three.js: light as spherical harmonics", "/v1/light?as=three"],
    ["three.js: light and objects as events", "/v1/events"], ["Prometheus", "/metrics"],
    ["OpenAPI", "/openapi.json"]];
  $("address-list").replaceChildren(...addresses.map(([name, path]) => {
    const code = element("code", {}, location.origin + path);
    const button = element("button", { type: "button", "aria-label": `Copy the address for ${name}` }, "Copy");
    button.addEventListener("click", () => copy(code, button));
    return element("li", {}, element("span", { class: "quiet" }, name), code, button);
  }));
}

/** The shape of the name: an eclipse. A blob, as the content security policy knows no data addresses. */
function setIcon() {
  const drawing = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><circle cx="8" cy="8" r="7.5" ' +
    'fill="#e8a33d"/><circle cx="10" cy="8" r="5" fill="#222a33"/></svg>';
  const href = URL.createObjectURL(new Blob([drawing], { type: "image/svg+xml" }));
  document.head.append(element("link", { rel: "icon", href }));
}

setIcon();
showAddresses();
listenToPointer();
listenToKeys();
listenToButtons();
document.addEventListener("visibilitychange", () => document.hidden ? leave() : connect());
addEventListener("pagehide", leave);
addEventListener("pageshow", (event) => event.persisted && !document.hidden && connect());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawCanvases);
setInterval(everySecond, 1000);
if (!document.hidden) connect();
