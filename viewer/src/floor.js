// Constraints in the room: paths and waypoints on the floor, balls where joints are wanted; drawn, and dragged.
import { BufferGeometry, Float32BufferAttribute, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, Plane, SphereGeometry, Vector3 } from "three";
import { drawnPath, handles, withHandle } from "./constraints.js";

const BALL = new SphereGeometry(1, 20, 14);
const SIZE = { path: 0.055, waypoint: 0.085, joint: 0.06 }; // metres
const LIFT = 0.012; // above the floor
const APART = 0.06; // metres between two points while one draws
const FAR = 12; // metres from the origin to which one may draw

/**
 * @param stage with overlay(group), ray(event), camera(), and orbit
 * @param on {change(at, constraint, done), drawn(path), colour(name) -> Color}
 */
export function createFloor(view, stage, on) {
  const group = new Group();
  const floor = new Plane(new Vector3(0, 1, 0), 0);
  let constraints = [];
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
      const points = handles(constraint);
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

  /** Follow the pointer until it is let go; the camera holds still meanwhile. */
  function follow(event, during, ended) {
    event.preventDefault();
    event.stopPropagation();
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
    const moved = (now) => {
      const point = stage.ray(now).ray.intersectPlane(plane, new Vector3());
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
      const hit = stage.ray(event).intersectObjects(group.children.filter((part) => part.isMesh))[0];
      if (hit) drag(event, hit.object.userData, hit.object.position.clone());
    },
    true, // before the camera takes it
  );

  return {
    show(shown, which) {
      [constraints, selected] = [shown, which];
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
