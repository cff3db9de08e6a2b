// What is drawn: a pane for each clip, all seen from the same side, each following its own root.
import {
  BufferGeometry, Color, DirectionalLight, Float32BufferAttribute, Fog, HemisphereLight, LineBasicMaterial, LineSegments,
  Mesh, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Raycaster, Scene, ShadowMaterial, Spherical, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const EYE = new Spherical(4.5, 1.36, 0.62); // metres, radians: from the front, a little from above and the left
const HEIGHT = 1.02; // of what the camera looks at: feet and a raised hand are in the picture
const TURN = 0.12; // radians per key
const FLOOR = 40; // metres

/** Lines a metre apart, cut into metres: lines that begin behind the camera are not drawn everywhere. */
function squares() {
  const corners = [];
  for (let x = -FLOOR / 2; x <= FLOOR / 2; x++) {
    for (let z = -FLOOR / 2; z < FLOOR / 2; z++) corners.push(x, 0, z, x, 0, z + 1, z, 0, x, z + 1, 0, x);
  }
  return new BufferGeometry().setAttribute("position", new Float32BufferAttribute(corners, 3));
}

const SQUARES = squares();

function createPane(actor) {
  const scene = new Scene();
  const sun = new DirectionalLight(0xffffff, 2.2);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, { left: -2, right: 2, top: 2.4, bottom: -2, near: 1, far: 14 });
  sun.shadow.radius = 5;
  sun.shadow.normalBias = 0.02;
  const floor = new Mesh(new PlaneGeometry(FLOOR, FLOOR).rotateX(-Math.PI / 2), new ShadowMaterial({ depthWrite: false }));
  floor.receiveShadow = true;
  const grid = new LineSegments(SQUARES, new LineBasicMaterial());
  scene.add(new HemisphereLight(0xffffff, 0x8d95a5, 1.5), sun, sun.target, grid, floor);
  const pane = {
    scene, sun, floor, grid, actor: null, camera: new PerspectiveCamera(34, 1, 0.1, 60),
    dispose: () => [sun, floor.geometry, floor.material, grid.material].forEach((part) => part.dispose()),
    /** Another actor, or none, in place of this one; what it holds stays. */
    cast(next) {
      const parts = (one) => (one ? [one.model, one.trail.whole, one.trail.past] : []);
      scene.remove(...parts(pane.actor));
      if (next) scene.add(...parts(next));
      pane.actor = next;
      return pane;
    },
  };
  return pane.cast(actor);
}

/** Columns that leave panes closest to a standing person's shape. */
function columns(count, width, height) {
  const shape = (across) => Math.abs(Math.log(width / across / (height / Math.ceil(count / across)) / 0.8));
  const ways = Array.from({ length: count }, (_, k) => k + 1);
  return ways.reduce((best, across) => (shape(across) < shape(best) ? across : best));
}

export function createStage(view) {
  const canvas = view.querySelector("canvas");
  const labels = view.querySelector(".panes");
  const renderer = new WebGLRenderer({ canvas, antialias: true });
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = PCFShadowMap;
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const rig = new PerspectiveCamera();
  const orbit = new OrbitControls(rig, canvas);
  Object.assign(orbit, { enablePan: false, minDistance: 1.5, maxDistance: 14, maxPolarAngle: 1.55 });
  const caster = new Raycaster();
  let overlay = null; // drawn with the newest clip
  let panes = [createPane(null)];
  let apart = null; // pane of small pictures
  const gone = []; // actors that are shown no more
  let time = 0;
  let asked = false;
  let moved = ""; // once somebody has been seen to move
  let begun; // told then
  const beginning = new Promise((resolve) => (begun = resolve));

  function draw() {
    asked = false;
    const { clientWidth: width, clientHeight: height } = view;
    const across = columns(panes.length, width, height);
    const [w, h] = [width / across, height / Math.ceil(panes.length / across)];
    renderer.setScissorTest(true);
    panes.forEach((pane, number) => {
      const [x, y] = [(number % across) * w, Math.floor(number / across) * h];
      pane.actor?.pose(time);
      render(pane, pane.actor ? pane.actor.target(time) : new Vector3(), [x, height - y - h, w, h]);
    });
    labels.style.gridTemplateColumns = `repeat(${across}, 1fr)`;
    canvas.dataset.time = time.toFixed(3);
    canvas.dataset.panes = panes.filter((pane) => pane.actor).length;
    // not before others are drawn: a material that is alone in its kind takes its program along, which is slow to make
    for (const actor of gone.splice(0)) actor.dispose();
    if (time > 0 && !moved) requestAnimationFrame(() => begun(performance.mark((moved = "moved"))));
  }

  function ask() {
    if (!asked) requestAnimationFrame(() => asked && draw()); // it may have been drawn at once meanwhile
    asked = true;
  }

  function paint(which = panes) {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => new Color(style.getPropertyValue(name).trim());
    for (const pane of which) {
      pane.scene.background = colour("--stage");
      pane.scene.fog = new Fog(colour("--stage"), 8, 20);
      pane.floor.material.opacity = Number(style.getPropertyValue("--shadow"));
      pane.grid.material.color = colour("--grid");
      if (!pane.actor) continue;
      if (pane.actor.body) pane.actor.body.material.color = colour(pane.actor.clip.level ? "--sketch" : "--body");
      for (const band of [pane.actor.trail.whole, pane.actor.trail.past]) band.material.color = colour("--accent");
    }
    ask();
  }

  /**
   * Show one pane in a part of the canvas, in CSS pixels from its lower left corner.
   * A narrow pane is looked at from further away, so that arms stay inside.
   */
  function render(pane, at, [x, y, w, h], far = Math.max(1, 0.66 / (w / h))) {
    pane.sun.target.position.copy(at);
    pane.sun.position.set(at.x + 2.5, 6, at.z + 3);
    at.y = HEIGHT;
    pane.camera.position.copy(rig.position).multiplyScalar(far).add(at);
    pane.camera.lookAt(at);
    pane.camera.aspect = w / h;
    pane.camera.updateProjectionMatrix();
    pane.scene.fog.near = 5 * far + rig.position.length();
    pane.scene.fog.far = 16 * far + rig.position.length();
    renderer.setViewport(x, y, w, h);
    renderer.setScissor(x, y, w, h);
    renderer.render(pane.scene, pane.camera);
  }

  /** The part of the window that shows the newest clip. */
  function newest() {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const across = columns(panes.length, width, height);
    const [w, h, last] = [width / across, height / Math.ceil(panes.length / across), panes.length - 1];
    return { left: left + (last % across) * w, top: top + Math.floor(last / across) * h, width: w, height: h };
  }

  function resize() {
    renderer.setSize(view.clientWidth, view.clientHeight, false);
    draw(); // at once: a canvas that was resized is empty
  }

  function recentre() {
    rig.position.setFromSpherical(EYE);
    orbit.update();
    ask();
  }

  canvas.addEventListener("keydown", (event) => {
    const [round, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    const nearer = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key] ?? 1;
    if (!round && !up && nearer === 1) return;
    event.preventDefault();
    const eye = new Spherical().setFromVector3(rig.position);
    eye.theta += round * TURN;
    eye.phi = Math.min(Math.max(eye.phi + up * TURN, 0.1), orbit.maxPolarAngle);
    eye.radius = Math.min(Math.max(eye.radius * nearer, orbit.minDistance), orbit.maxDistance);
    rig.position.setFromSpherical(eye);
    orbit.update();
  });
  orbit.addEventListener("change", ask);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paint());
  recentre();
  paint();
  new ResizeObserver(resize).observe(view);

  return {
    recentre,
    /** Resolves when somebody has been seen to move. */
    beginning,
    orbit,
    ask,
    overlay(object) {
      overlay = object;
      panes.at(-1).scene.add(overlay);
    },
    /** A colour of the page. */
    colour: (name) => new Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim()),
    camera: () => panes.at(-1).camera,
    /** What lies under the pointer in the pane of the newest clip, as a Raycaster. */
    ray({ clientX, clientY }) {
      const { left, top, width, height } = newest();
      caster.setFromCamera(new Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height), panes.at(-1).camera);
      return caster;
    },
    /** Where a point of the newest clip's pane is seen, as a pointer's {clientX, clientY}; null behind the camera. */
    screen(point) {
      const { left, top, width, height } = newest();
      const { x, y, z } = point.clone().project(panes.at(-1).camera);
      return z < 1 ? { clientX: left + ((x + 1) * width) / 2, clientY: top + ((1 - y) * height) / 2 } : null;
    },
    /** A small picture of an actor at a time, as a data URL; what is seen comes back before anybody looks. */
    picture(actor, seconds) {
      const pane = (apart ??= createPane(null)).cast(actor);
      paint([pane]);
      actor.pose(seconds);
      const [w, h] = [Math.min(96, view.clientWidth), Math.min(72, view.clientHeight)];
      renderer.setScissorTest(true);
      render(pane, actor.target(seconds), [0, 0, w, h], 0.8);
      const ratio = renderer.getPixelRatio();
      const small = Object.assign(document.createElement("canvas"), { width: w * ratio, height: h * ratio });
      small.getContext("2d").drawImage(canvas, 0, h * ratio - canvas.height);
      pane.cast(null);
      panes.find((other) => other.actor === actor)?.cast(actor);
      draw();
      return small.toDataURL();
    },
    /** Show these clips, side by side; others go, and free what they hold. */
    show(actors) {
      const before = panes;
      gone.push(...before.map(({ actor }) => actor).filter((actor) => actor && !actors.includes(actor)));
      for (const pane of before) pane.cast(null);
      panes = (actors.length ? actors : [null]).map((actor, at) => (before[at] ?? createPane(null)).cast(actor));
      for (const pane of before.slice(panes.length)) pane.dispose();
      if (overlay) panes.at(-1).scene.add(overlay);
      labels.replaceChildren(
        ...actors.map(({ clip }) => {
          const label = document.createElement("p");
          label.textContent = actors.length > 1 || clip.level ? clip.label ?? clip.text : "";
          return label;
        }),
      );
      canvas.setAttribute("aria-label", actors.map(({ clip }) => clip.text).join("; ") || "No clip yet");
      paint();
    },
    /** Whether everything that is seen comes back to its first frame, at the same time. */
    get loops() {
      const clips = panes.flatMap(({ actor }) => actor ?? []);
      return clips.length > 0 && clips.every((actor) => actor.clip.loops && actor.duration === this.duration);
    },
    /** Seconds of the longest clip. */
    get duration() {
      return Math.max(0, ...panes.map(({ actor }) => actor?.duration ?? 0));
    },
    /** Seconds between frames of the first clip. */
    get frame() {
      return 1 / (panes[0].actor?.clip.fps ?? 20);
    },
    at(seconds) {
      time = seconds;
      ask();
    },
  };
}
