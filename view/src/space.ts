// Both hands in metres, the camera's frustum and a floor, seen from anywhere.
//
// The camera's frame is x right, y down, z forward; three's is y up, z backward: (x, y, z) -> (x, -y, -z).

import {
  Box3,
  BufferGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  GridHelper,
  HemisphereLight,
  InstancedMesh,
  LineBasicMaterial,
  LineDashedMaterial,
  LineSegments,
  Matrix4,
  MeshLambertMaterial,
  PerspectiveCamera,
  Quaternion,
  Scene,
  Sphere,
  SphereGeometry,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { type Camera, type Frame, SIDES, type Side } from "./records";
import { BONES, HAND_COLOURS, ROOT, css, jointColour } from "./skeleton";

/** How far the scene reaches; the first that holds all hands. */
const REACHES_M = [0.6, 1, 2, 4, 8];
/** Of the floor below the camera. */
const LEAST_DROP_M = 0.25;
/** What is drawn before there is a clip. */
const USUAL: Camera = { fx: 830, fy: 830, cx: 480, cy: 270, width: 960, height: 540 };
const UP = new Vector3(0, 1, 0);

interface HandMeshes {
  joints: InstancedMesh;
  bones: InstancedMesh;
  ray: LineSegments;
  label: HTMLElement;
}

/** A point of the camera's frame in three's. */
function toScene(point: readonly number[]): Vector3 {
  return new Vector3(point[0], -(point[1] ?? 0), -(point[2] ?? 0));
}

export class Space {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly eye = new PerspectiveCamera(42, 1, 0.01, 60);
  private readonly controls: OrbitControls;
  private readonly hands: Record<Side, HandMeshes>;
  private readonly frustum = new LineSegments(
    new BufferGeometry(),
    new LineBasicMaterial({ color: 0x7f8a9a, transparent: true, opacity: 0.75 }),
  );
  private readonly marks: HTMLElement[] = [];
  private floor: GridHelper | null = null;
  private floorAt = 0;
  private reach = 0;
  /** Joints that are seen now, and how many there were when the view was last chosen. */
  private shown: Vector3[] = [];
  private framed = 0;
  private camera: Camera | null = null;
  private following = true;
  private waiting = false;

  /**
   * Throws where the browser has no WebGL.
   * @param slow whether it is emulated: edges are rough then, and pixels as few as can be.
   */
  constructor(
    private readonly box: HTMLElement,
    slow: boolean,
  ) {
    this.renderer = new WebGLRenderer({ antialias: !slow, alpha: true, powerPreference: "low-power" });
    this.renderer.setPixelRatio(slow ? 1 : Math.min(2, devicePixelRatio));
    box.prepend(this.renderer.domElement);
    this.scene.add(new HemisphereLight(0xffffff, 0x555a66, 2.2));
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(0.4, 1, 0.6);
    this.frustum.frustumCulled = false; // it grows after it was first seen
    this.scene.add(sun, this.frustum);
    this.controls = new OrbitControls(this.eye, this.renderer.domElement);
    this.controls.addEventListener("change", () => this.ask());
    this.controls.addEventListener("start", () => (this.following = false));
    this.hands = { left: this.makeHand("left"), right: this.makeHand("right") };
    new ResizeObserver(() => this.resize()).observe(box);
    this.setCamera(USUAL);
    this.furnish(REACHES_M[0]!, LEAST_DROP_M);
    this.lookFrom("side");
  }

  /** The camera whose frustum is drawn. */
  setCamera(camera: Camera): void {
    this.camera = camera;
    this.reach = 0;
    this.floorAt = 0;
    this.framed = 0;
  }

  /** Looks from beside, from above, or as the camera does, so that camera and hands fill the view. */
  lookFrom(where: "side" | "camera" | "above"): void {
    this.following = true;
    const as_camera = where === "camera" && this.camera !== null;
    this.eye.fov = as_camera ? this.fieldOfView(this.camera!) : 40;
    this.eye.updateProjectionMatrix();
    const all = this.shown.length > 0 ? this.shown : this.corners(this.reach);
    const { center, radius } = new Box3().setFromPoints([...all, new Vector3()]).getBoundingSphere(new Sphere());
    if (as_camera) {
      this.controls.target.set(0, 0, center.z * 2);
      this.eye.position.set(0, 0, 1e-3);
    } else {
      const half = (Math.PI / 360) * this.eye.fov;
      const narrow = Math.min(half, Math.atan(Math.tan(half) * this.eye.aspect));
      const from = where === "above" ? new Vector3(0, 1, 1e-3) : new Vector3(0.86, 0.48, 0.5);
      this.controls.target.copy(center);
      this.eye.position.copy(from.setLength((1.08 * radius) / Math.sin(narrow)).add(center));
    }
    this.controls.update();
    this.ask();
  }

  draw(frame: Frame): void {
    for (const side of SIDES) this.drawHand(frame, side);
    const joints = SIDES.flatMap((side) => frame.hands[side].joints_m ?? []);
    const farthest = Math.max(0, ...joints.map((joint) => joint[2] ?? 0));
    const lowest = Math.max(LEAST_DROP_M, ...joints.map((joint) => (joint[1] ?? 0) + 0.06));
    const reach = REACHES_M.find((each) => each >= farthest) ?? REACHES_M[REACHES_M.length - 1]!;
    this.shown = joints.map(toScene);
    if (reach > this.reach || lowest > this.floorAt) this.furnish(Math.max(reach, this.reach), lowest);
    // The first hands that are seen, or one that has come beside another.
    if (this.following && joints.length > this.framed) {
      this.framed = joints.length;
      this.lookFrom("side");
    }
    this.ask();
  }

  private furnish(reach: number, lowest: number): void {
    if (reach > this.reach) this.framed = 0;
    this.reach = reach;
    this.floorAt = Math.max(this.floorAt, Math.ceil(10 * lowest) / 10);
    if (this.floor !== null) {
      this.scene.remove(this.floor);
      this.floor.dispose();
    }
    const size = 2 * reach;
    this.floor = new GridHelper(size, Math.round(size / (reach > 1 ? 0.5 : 0.1)), 0x4a5361, 0x2f3641);
    this.floor.position.set(0, -this.floorAt, -reach / 2);
    this.scene.add(this.floor);
    this.drawFrustum(reach);
    for (const mark of this.marks.splice(0)) mark.remove();
    for (let part = 1; part <= 4; part++) this.addMark((part * reach) / 4);
  }

  private drawFrustum(reach: number): void {
    if (this.camera === null) return;
    const { cx, width, height } = this.camera;
    const near = 0.08;
    const [far, close] = [this.corners(reach), this.corners(near)];
    const points: Vector3[] = [];
    for (let i = 0; i < 4; i++) {
      const next = (i + 1) % 4;
      points.push(new Vector3(), far[i]!, far[i]!, far[next]!, close[i]!, close[next]!);
    }
    // Which way is up: a small roof over the near rectangle.
    const roof = this.at(cx, -0.35 * height, near);
    const [from, to] = [this.at(0.3 * width, -0.06 * height, near), this.at(0.7 * width, -0.06 * height, near)];
    points.push(from, roof, roof, to);
    this.frustum.geometry.setFromPoints(points);
  }

  /** What is seen at a pixel, so many metres before the camera. */
  private at(u: number, v: number, depth: number): Vector3 {
    const { fx, fy, cx, cy } = this.camera ?? USUAL;
    return toScene([(depth * (u - cx)) / fx, (depth * (v - cy)) / fy, depth]);
  }

  /** The corners of the picture, so many metres before the camera. */
  private corners(depth: number): Vector3[] {
    const { width, height } = this.camera ?? USUAL;
    return [this.at(0, 0, depth), this.at(width, 0, depth), this.at(width, height, depth), this.at(0, height, depth)];
  }

  private drawHand(frame: Frame, side: Side): void {
    const { joints, bones, ray, label } = this.hands[side];
    const hand = frame.hands[side];
    const shown = hand.present && hand.joints_m !== null;
    joints.visible = bones.visible = ray.visible = shown;
    label.hidden = !shown;
    if (!shown) return;
    const points = hand.joints_m!.map(toScene);
    const root = points[ROOT]!;
    const size = points[0]!.distanceTo(root);
    const matrix = new Matrix4();
    points.forEach((point, joint) => {
      const radius = size * (joint === 0 ? 0.085 : 0.068);
      joints.setMatrixAt(joint, matrix.compose(point, new Quaternion(), new Vector3(radius, radius, radius)));
    });
    BONES.forEach(([from, to], bone) => {
      const along = points[to]!.clone().sub(points[from]!);
      const middle = points[from]!.clone().add(points[to]!).multiplyScalar(0.5);
      const turn = new Quaternion().setFromUnitVectors(UP, along.clone().normalize());
      const radius = 0.045 * size;
      bones.setMatrixAt(bone, matrix.compose(middle, turn, new Vector3(radius, along.length(), radius)));
    });
    joints.instanceMatrix.needsUpdate = bones.instanceMatrix.needsUpdate = true;
    const below = new Vector3(root.x, -this.floorAt, root.z);
    ray.geometry.setFromPoints([new Vector3(), root, root, below]);
    ray.computeLineDistances();
    label.textContent = hand.range_m === null ? "" : `${(100 * hand.range_m).toFixed(1)} cm`;
    const top = points.reduce((highest, point) => (point.y > highest.y ? point : highest));
    label.dataset.at = [top.x, top.y + 0.3 * size, top.z].join(" ");
    const faint = hand.method === "predicted" ? 0.45 : 1;
    (joints.material as MeshLambertMaterial).opacity = (bones.material as MeshLambertMaterial).opacity = faint;
  }

  private makeHand(side: Side): HandMeshes {
    const material = () => new MeshLambertMaterial({ transparent: true });
    const joints = new InstancedMesh(new SphereGeometry(1, 16, 12), material(), 21);
    const bones = new InstancedMesh(new CylinderGeometry(1, 1, 1, 12), material(), BONES.length);
    const colour = new Color();
    for (let joint = 0; joint < 21; joint++) {
      joints.setColorAt(joint, colour.set(css(jointColour(side, joint)).replace(/ \/ .*/, ")").replace(/ /g, ",")));
    }
    BONES.forEach(([, to], bone) => {
      bones.setColorAt(bone, colour.set(css(jointColour(side, to)).replace(/ \/ .*/, ")").replace(/ /g, ",")));
    });
    const [red, green, blue] = HAND_COLOURS[side];
    const line = new LineDashedMaterial({ dashSize: 0.012, gapSize: 0.01, transparent: true, opacity: 0.7 });
    line.color.set(`rgb(${red},${green},${blue})`);
    const ray = new LineSegments(new BufferGeometry(), line);
    for (const each of [joints, bones, ray]) {
      each.frustumCulled = false;
      each.visible = false;
      this.scene.add(each);
    }
    const label = this.makeLabel(`mark ${side}`);
    label.hidden = true;
    return { joints, bones, ray, label };
  }

  private addMark(depth: number): void {
    const mark = this.makeLabel("mark");
    mark.textContent = `${+depth.toFixed(2)} m`;
    mark.dataset.at = [0, -this.floorAt, -depth].join(" ");
    this.marks.push(mark);
  }

  private makeLabel(kind: string): HTMLElement {
    const label = document.createElement("span");
    label.className = kind;
    this.box.append(label);
    return label;
  }

  /** Vertical field of view, degrees, in which the box holds the camera's whole picture. */
  private fieldOfView(camera: Camera): number {
    const tall = camera.height / camera.fy / 2;
    const wide = camera.width / camera.fx / 2 / this.eye.aspect;
    return Math.min(150, (360 / Math.PI) * Math.atan(1.02 * Math.max(tall, wide)));
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.box;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.eye.aspect = width / height;
    this.eye.updateProjectionMatrix();
    this.ask();
  }

  /** One drawing before the browser next shows something, however often it is asked for. */
  private ask(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.renderer.render(this.scene, this.eye);
      this.placeLabels();
    });
  }

  private placeLabels(): void {
    const { clientWidth: width, clientHeight: height } = this.box;
    for (const label of this.box.querySelectorAll<HTMLElement>(".mark[data-at]")) {
      const [x, y, z] = label.dataset.at!.split(" ").map(Number);
      const seen = new Vector3(x, y, z).project(this.eye);
      label.style.visibility = Math.abs(seen.z) < 1 ? "visible" : "hidden";
      label.style.transform = `translate(-50%, -50%) translate(${((1 + seen.x) * width) / 2}px, ${((1 - seen.y) * height) / 2}px)`;
    }
  }
}
