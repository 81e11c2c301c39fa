// The arm in three dimensions on a plain canvas: links by forward kinematics, path, workspace box, target zone, gripper.
//
// The camera looks at the middle of the workspace from `yaw` and `pitch`; at first from behind the arm's base, so that
// the arm's left is the screen's left. The base's x points ahead, y to the left, z up.

import { colour, FONT, Sheet } from "./paint.js";
import { isInZone, zoneOf } from "./task.js";
import { number, show, text } from "./texts.js";

const START_VIEW = { yaw: -2.55, pitch: 0.42 };
const KEY_TURN_RAD = Math.PI / 24;
const DRAG_RAD_PER_PX = 0.008;
const MARGIN_PX = 20;
const PATH_MS = 10_000;
/** Pulses of the xArm gripper when it is open. */
const GRIPPER_OPEN_PULSES = 850;

/** Homogeneous transforms as [rotation by rows (9), translation (3)]. */
function compose(a, b) {
  const result = new Array(12);
  for (let row = 0; row < 3; row += 1) {
    for (let column = 0; column < 3; column += 1) {
      result[3 * row + column] =
        a[3 * row] * b[column] + a[3 * row + 1] * b[3 + column] + a[3 * row + 2] * b[6 + column];
    }
    result[9 + row] = a[3 * row] * b[9] + a[3 * row + 1] * b[10] + a[3 * row + 2] * b[11] + a[9 + row];
  }
  return result;
}

const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];
const origin = (pose) => pose.slice(9);

/**
 * The corners of the arm from base to flange in mm, and the flange's pose. Modified Denavit-Hartenberg parameters (Craig,
 * Introduction to Robotics, eq. 3.6): along x by a, about x by alpha, about z by theta, along z by d.
 */
export function forwardKinematics(joints, anglesRad) {
  let pose = IDENTITY;
  const corners = [[0, 0, 0]];
  joints.forEach(({ a_mm, d_mm, alpha_rad, theta_offset_rad }, index) => {
    const [ca, sa] = [Math.cos(alpha_rad), Math.sin(alpha_rad)];
    const theta = anglesRad[index] + (theta_offset_rad ?? 0);
    const [ct, st] = [Math.cos(theta), Math.sin(theta)];
    pose = compose(pose, [1, 0, 0, 0, ca, -sa, 0, sa, ca, a_mm, 0, 0]);
    if (a_mm !== 0) corners.push(origin(pose));
    pose = compose(pose, [ct, -st, 0, st, ct, 0, 0, 0, 1, 0, 0, d_mm]);
    if (d_mm !== 0) corners.push(origin(pose));
  });
  return { corners, flange: pose };
}

export class ArmView {
  constructor(redraw) {
    this.redraw = redraw;
    this.sheet = new Sheet(document.getElementById("arm-canvas"), redraw);
    this.facts = document.getElementById("arm-facts");
    this.view = { ...START_VIEW };
    this.path = [];
    this.listen(this.sheet.canvas);
  }

  listen(canvas) {
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = { x: event.clientX, y: event.clientY };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (from === null) return;
      this.turn(-(event.clientX - from.x) * DRAG_RAD_PER_PX, (event.clientY - from.y) * DRAG_RAD_PER_PX);
      from = { x: event.clientX, y: event.clientY };
    });
    for (const end of ["pointerup", "pointercancel"])
      canvas.addEventListener(end, () => {
        from = null;
      });
    const turns = {
      ArrowLeft: [KEY_TURN_RAD, 0],
      ArrowRight: [-KEY_TURN_RAD, 0],
      ArrowUp: [0, KEY_TURN_RAD],
      ArrowDown: [0, -KEY_TURN_RAD],
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.key === "Home") this.view = { ...START_VIEW };
      else if (!(event.key in turns)) return;
      event.preventDefault();
      this.turn(...(turns[event.key] ?? [0, 0]));
    });
  }

  turn(yaw, pitch) {
    this.view.yaw += yaw;
    this.view.pitch = Math.max(-0.2, Math.min(1.5, this.view.pitch + pitch));
    this.redraw();
  }

  setUp(hello) {
    this.hello = hello;
    this.state = this.desk = null;
    this.path = [];
  }

  showDesk(desk) {
    this.desk = desk;
  }

  showState(state) {
    const isSame = this.state?.now_ns === state.now_ns;
    this.state = state;
    // Before the arm has reported, all its values are zero.
    this.isKnown = (state.joints_rad ?? []).length === 7 && state.position_mm.some((value) => value !== 0);
    if (this.isKnown && !isSame) this.path.push({ atMs: state.now_ns / 1e6, point: state.position_mm });
    while (this.path.length > 0 && this.path[0].atMs < state.now_ns / 1e6 - PATH_MS) this.path.shift();
    const [x, y, z] = this.isKnown ? state.position_mm : [];
    const facts = [
      text("arm-facts", { x: number(x), y: number(y), z: number(z), speed: number(state.speed_mm_per_s) }),
    ];
    const opening = gripperOpening(state.gripper);
    if (opening !== null) facts.push(text("gripper-is", { percent: number(100 * opening) }));
    show(this.facts, facts.join(" · "));
  }

  draw() {
    const { sheet, hello, state } = this;
    sheet.clear();
    if (!hello) return;
    const { min, max } = hello.workspace_mm;
    this.project = this.camera(min, max);
    this.drawFloor(min, max);
    this.drawBox(min, max);
    if (!state || !this.isKnown) return;
    this.drawPath();
    this.drawArm(state);
    // Above the arm, which would hide the target that it is in.
    const zone = zoneOf(this.desk, state);
    if (zone) this.drawZone(zone, isInZone(zone, state.position_mm));
  }

  /** The projection that shows the workspace box and the arm's base as large as the canvas lets it. */
  camera(min, max) {
    const { sheet } = this;
    const [cy, sy] = [Math.cos(this.view.yaw), Math.sin(this.view.yaw)];
    const [cp, sp] = [Math.cos(this.view.pitch), Math.sin(this.view.pitch)];
    const middle = [(Math.min(0, min[0]) + max[0]) / 2, (min[1] + max[1]) / 2, max[2] / 2];
    const distance = 4 * Math.hypot(...max.map((value, axis) => value - middle[axis]));
    const project = (point) => {
      const [dx, dy, dz] = point.map((value, axis) => value - middle[axis]);
      const perspective = distance / (distance - (dx * cy + dy * sy) * cp - dz * sp);
      return [(-dx * sy + dy * cy) * perspective, (-(dx * cy + dy * sy) * sp + dz * cp) * perspective, perspective];
    };
    const shown = [[0, 0, max[2]]];
    for (const y of [min[1], max[1]]) {
      shown.push([0, y, 0]);
      for (const x of [min[0], max[0]]) for (const z of [0, max[2]]) shown.push([x, y, z]);
    }
    const [across, up] = [0, 1].map((axis) => {
      const values = shown.map((point) => project(point)[axis]);
      return { least: Math.min(...values), most: Math.max(...values) };
    });
    const scale = Math.min(
      (sheet.width - 2 * MARGIN_PX) / (across.most - across.least),
      (sheet.height - 2 * MARGIN_PX) / (up.most - up.least),
    );
    return (point) => {
      const [right, above, perspective] = project(point);
      return [
        sheet.width / 2 + (right - (across.least + across.most) / 2) * scale,
        sheet.height / 2 - (above - (up.least + up.most) / 2) * scale,
        perspective * scale,
      ];
    };
  }

  stroke(points, name, width, dash = []) {
    const { context } = this.sheet;
    context.strokeStyle = colour(name);
    context.lineWidth = width;
    context.lineCap = context.lineJoin = "round";
    context.setLineDash(dash);
    context.beginPath();
    points.map(this.project).forEach(([x, y], index) => (index === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
    context.stroke();
    context.setLineDash([]);
  }

  drawFloor(min, max) {
    const step = 200;
    for (let y = Math.floor(min[1] / step) * step; y <= max[1]; y += step)
      this.stroke(
        [
          [0, y, 0],
          [max[0], y, 0],
        ],
        "line",
        1,
      );
    for (let x = 0; x <= max[0]; x += step)
      this.stroke(
        [
          [x, min[1], 0],
          [x, max[1], 0],
        ],
        "line",
        1,
      );
  }

  drawBox(min, max) {
    const corner = (bits) => [0, 1, 2].map((axis) => ((bits >> axis) & 1 ? max[axis] : min[axis]));
    for (let bits = 0; bits < 8; bits += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        if (!((bits >> axis) & 1)) this.stroke([corner(bits), corner(bits | (1 << axis))], "quiet", 1.2, [5, 5]);
      }
    }
    const { context } = this.sheet;
    context.fillStyle = colour("quiet");
    context.font = `13px ${FONT}`;
    context.textAlign = "center";
    const [x, y] = this.project([(min[0] + max[0]) / 2, max[1], max[2]]);
    context.fillText(text("workspace-left"), x, y - 8);
    const [otherX, otherY] = this.project([(min[0] + max[0]) / 2, min[1], max[2]]);
    context.fillText(text("workspace-right"), otherX, otherY - 8);
    context.textAlign = "left";
  }

  /** The target: filled and green while the arm is in it; a line down to the floor tells where it is in space. */
  drawZone(zone, isInside) {
    const { context } = this.sheet;
    const half = zone.width_mm / 2;
    const name = isInside ? "good" : "zone";
    const [x, y, z] = zone.center_mm;
    this.stroke(
      [
        [x, y, z - half],
        [x, y, 0],
      ],
      name,
      1.5,
      [2, 5],
    );
    context.fillStyle = colour(name);
    context.globalAlpha = isInside ? 0.45 : 0.22;
    if (zone.shape === "cube") {
      const corner = (bits) => zone.center_mm.map((centre, axis) => centre + ((bits >> axis) & 1 ? half : -half));
      context.beginPath();
      hullOf([0, 1, 2, 3, 4, 5, 6, 7].map((bits) => this.project(corner(bits)))).forEach(([px, py]) =>
        context.lineTo(px, py),
      );
      context.fill();
      context.globalAlpha = 1;
      for (let bits = 0; bits < 8; bits += 1) {
        for (let axis = 0; axis < 3; axis += 1) {
          if (!((bits >> axis) & 1)) this.stroke([corner(bits), corner(bits | (1 << axis))], name, 2.5);
        }
      }
      return;
    }
    const [px, py, perspective] = this.project(zone.center_mm);
    context.beginPath();
    context.arc(px, py, half * perspective, 0, 2 * Math.PI);
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour(name);
    context.lineWidth = 3;
    context.stroke();
  }

  drawPath() {
    if (this.path.length > 1)
      this.stroke(
        this.path.map(({ point }) => point),
        "path",
        2.5,
      );
  }

  drawArm(state) {
    const { corners, flange } = forwardKinematics(this.hello.arm.joints, state.joints_rad);
    const tip = origin(flange);
    const floor = (point) => [point[0], point[1], 0];
    this.stroke(corners.map(floor), "line", 7);
    this.stroke([tip, floor(tip)], "quiet", 1, [2, 4]);
    const perspective = this.project(middleOf(corners))[2];
    this.stroke(corners, "link", Math.max(5, 78 * perspective));
    this.stroke(corners, "joint", Math.max(2, 26 * perspective));
    this.drawGripper(flange, gripperOpening(state.gripper), perspective);
  }

  /** Two fingers along the flange's own z, apart along its y; without a gripper, a plate. */
  drawGripper(flange, opening, perspective) {
    const at = (y, z) => origin(compose(flange, [...IDENTITY.slice(0, 9), 0, y, z]));
    const apart = opening === null ? 30 : 8 + 42 * opening;
    const width = Math.max(2.5, 18 * perspective);
    if (opening === null) {
      this.stroke([at(-apart, 0), at(apart, 0)], "joint", width);
      return;
    }
    this.stroke([at(0, 0), at(0, 40)], "joint", width);
    this.stroke([at(-apart, 110), at(-apart, 50), at(apart, 50), at(apart, 110)], "joint", width);
  }
}

/** The convex hull of points in the plane, in order (Andrew's monotone chain). */
function hullOf(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  const chain = (ordered) => {
    const kept = [];
    for (const point of ordered) {
      while (kept.length > 1 && turn(kept.at(-2), kept.at(-1), point) <= 0) kept.pop();
      kept.push(point);
    }
    return kept.slice(0, -1);
  };
  return [...chain(sorted), ...chain(sorted.reverse())];
}

const middleOf = (corners) => corners[Math.floor(corners.length / 2)];

/** How far the gripper is open, 0 to 1; null where there is none. */
function gripperOpening(gripper) {
  if (gripper === "open") return 1;
  if (gripper === "closed") return 0;
  if (typeof gripper !== "number" || !Number.isFinite(gripper)) return null;
  return Math.max(0, Math.min(1, gripper / GRIPPER_OPEN_PULSES));
}
