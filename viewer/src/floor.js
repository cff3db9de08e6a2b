// Constraints in the room: paths and waypoints on the floor, balls where joints are wanted; drawn, and dragged.
import { BufferGeometry, Float32BufferAttribute, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, Plane, SphereGeometry, Vector3 } from "three";
import { drawnPath, handles, withHandle } from "./constraints.js";

const BALL = new SphereGeometry(1, 20, 14);
const SIZE = { path: 0.055, waypoint: 0.085, joint: 0.06 }; // metres
const LIFT = 0.012; // above the floor
const APART = 0.06; // metres between two points while one draws
const FAR = 12; // metres from the origin to which one may draw
const GRASP = 14; // pixels from a ball at which the mouse takes hold of it
const FINGER = 26;

/**
 * @param stage with overlay(group), ray(event), screen(point), camera(), and orbit
 * @param on {change(at, constraint, done), drawn(path), held() when something is taken hold of, colour(name) -> Color}
 */
export function createFloor(view, stage, on) {
  const group = new Group();
  const floor = new Plane(new Vector3(0, 1, 0), 0);
  let constraints = [];
  let places = []; // where the joints of pins with free axes are in the clip that is seen
  let selected = -1;
  let pencil = null; // points while a path is being drawn
  stage.overlay(group);

  function clear() {
    for (const part of group.children) {
      if (part.isLine) part.geometry.dispose();
      part.material.dispose();
    }
    group.clear();
  }

  function line(points, colour) {
    const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points.flat(), 3));
    group.add(new Line(geometry, new LineBasicMaterial({ color: colour, depthTest: false, transparent: true })));
  }

  function draw() {
    clear();
    constraints.forEach((constraint, at) => {
      const colour = on.colour(at === selected ? "--accent" : "--pin");
      const points = handles(constraint, places[at]);
      if (constraint.type === "path") line(points.map(([x, , z]) => [x, LIFT, z]), colour);
      points.forEach((point, handle) => {
        const ball = new Mesh(BALL, new MeshBasicMaterial({ color: colour, depthTest: false, transparent: true }));
        ball.position.set(...point);
        if (constraint.type !== "joint") ball.position.y = LIFT;
        ball.scale.setScalar(SIZE[constraint.type]);
        if (constraint.type !== "joint") ball.scale.y = 0.012;
        Object.assign(ball, { renderOrder: 2, userData: { at, handle } });
        group.add(ball);
        if (constraint.type === "joint") line([[point[0], LIFT, point[2]], point], colour);
      });
    });
    if (pencil?.length > 1) line(pencil.map(([x, z]) => [x, LIFT, z]), on.colour("--accent"));
    stage.ask();
  }

  const onFloor = (event) => {
    const point = stage.ray(event).ray.intersectPlane(floor, new Vector3());
    return point && point.length() < FAR ? point : null;
  };

  function sketch(event) {
    const point = onFloor(event);
    if (!point) return;
    const last = pencil.at(-1);
    if (last && Math.hypot(point.x - last[0], point.z - last[1]) < APART) return;
    pencil.push([point.x, point.z]);
    draw();
  }

  /** The ball that is nearest to a pointer, or null: a disc on the floor is seen from the side, so near is enough. */
  function grasped({ clientX, clientY, pointerType }) {
    let [nearest, best] = [null, pointerType === "touch" ? FINGER : GRASP];
    for (const ball of group.children.filter((part) => part.isMesh)) {
      const seen = stage.screen(ball.position);
      const far = seen ? Math.hypot(seen.clientX - clientX, seen.clientY - clientY) : Infinity;
      if (far < best) [nearest, best] = [ball, far];
    }
    return nearest;
  }

  /** Follow the pointer until it is let go; the camera holds still meanwhile. */
  function follow(event, during, ended) {
    event.preventDefault();
    event.stopPropagation();
    on.held();
    stage.orbit.enabled = false;
    view.setPointerCapture(event.pointerId);
    const onend = (now) => {
      view.removeEventListener("pointermove", during);
      for (const kind of ["pointerup", "pointercancel"]) view.removeEventListener(kind, onend);
      stage.orbit.enabled = true;
      ended(now);
    };
    view.addEventListener("pointermove", during);
    for (const kind of ["pointerup", "pointercancel"]) view.addEventListener(kind, onend);
  }

  function drag(event, { at, handle }, from) {
    // a joint moves in a plane that faces the camera, all else on the floor
    const isJoint = constraints[at].type === "joint";
    const plane = isJoint ? new Plane().setFromNormalAndCoplanarPoint(stage.camera().getWorldDirection(new Vector3()), from) : floor;
    const under = (now) => stage.ray(now).ray.intersectPlane(plane, new Vector3());
    const beside = under(event)?.sub(from) ?? new Vector3(); // it may be held beside its middle
    if (!isJoint) beside.y = 0;
    const moved = (now) => {
      const point = under(now)?.sub(beside);
      return point && point.length() < FAR ? withHandle(constraints[at], handle, point.toArray()) : null;
    };
    let last = null;
    follow(
      event,
      (now) => {
        last = moved(now) ?? last;
        if (!last) return;
        constraints = constraints.with(at, last);
        draw();
        on.change(at, last, false);
      },
      () => last && on.change(at, last, true),
    );
  }

  view.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button || event.target.tagName !== "CANVAS") return;
      if (pencil) {
        pencil = [];
        sketch(event);
        follow(event, sketch, () => {
          const points = pencil;
          pencil = null;
          view.classList.remove("pencil");
          draw();
          on.drawn(points.length > 1 ? drawnPath(points) : null);
        });
        return;
      }
      const ball = grasped(event);
      if (ball) drag(event, ball.userData, ball.position.clone());
    },
    true, // before the camera takes it
  );

  view.addEventListener("pointermove", (event) => {
    if (!event.buttons) view.classList.toggle("grab", !pencil && grasped(event) !== null);
  });

  return {
    /** seen: for each pin with a free axis, where its joint is in the clip, [x, y, z]. */
    show(shown, which, seen = places) {
      [constraints, selected, places] = [shown, which, seen];
      draw();
    },
    /** Let the next press draw a path; once more, or Escape, and it does not. */
    pencil(is) {
      pencil = is ? [] : null;
      view.classList.toggle("pencil", is);
    },
    get drawing() {
      return pencil !== null;
    },
  };
}
