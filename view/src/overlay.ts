// The picture with both hands drawn over it.

import { type Camera, type Frame, type Hand, SIDES, type Side } from "./records";
import { BONES, HAND_COLOURS, ROOT, css, jointColour } from "./skeleton";

export type Picture = CanvasImageSource;

export class Overlay {
  private readonly context: CanvasRenderingContext2D;

  /** @param inMemory draw there, rather than by the graphics card. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    inMemory: boolean,
  ) {
    this.context = canvas.getContext("2d", { alpha: false, willReadFrequently: inMemory })!;
  }

  /** Draws a frame; without a picture, on black. A mirrored picture is turned back, as the estimator did. */
  draw(picture: Picture | null, camera: Camera, frame: Frame, mirrored: boolean): void {
    const { canvas, context } = this;
    // As many pixels as are seen, so that lines are sharp on a small picture too.
    const shown = canvas.clientWidth * devicePixelRatio || camera.width;
    const scale = Math.max(1, Math.min(2, shown / camera.width));
    const width = Math.round(camera.width * scale);
    const height = Math.round(camera.height * scale);
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    if (picture === null) {
      context.fillStyle = "#0b0c0f";
      context.fillRect(0, 0, width, height);
    } else {
      if (mirrored) context.setTransform(-1, 0, 0, 1, width, 0);
      context.drawImage(picture, 0, 0, width, height);
    }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    const far = (side: Side) => frame.hands[side].range_m ?? 0;
    // One picture pixel of the canvas, as large as it is seen.
    const unit = Math.max(1, (camera.width * devicePixelRatio) / Math.max(1, shown));
    for (const side of [...SIDES].sort((a, b) => far(b) - far(a))) this.hand(frame.hands[side], side, camera, unit);
  }

  private hand(hand: Hand, side: Side, camera: Camera, unit: number): void {
    const points = hand.joints_px;
    if (!hand.present || points === null) return;
    const { context } = this;
    const at = (joint: number) => points[joint] as [number, number];
    const known = (joint: number) => at(joint)?.every((value) => Number.isFinite(value) && value !== null);
    const depth = (joint: number) => hand.joints_m?.[joint]?.[2] ?? 0;
    const bones = [...BONES].sort((a, b) => depth(b[0]) + depth(b[1]) - depth(a[0]) - depth(a[1]));
    const predicted = hand.method === "predicted";
    context.lineCap = "round";
    context.globalAlpha = predicted ? 0.45 : 1;
    for (const [from, to] of bones) {
      if (!known(from) || !known(to)) continue;
      for (const [colour, width] of [["rgb(20 22 26 / 0.9)", 5], [css(jointColour(side, to)), 2.6]] as const) {
        context.strokeStyle = colour;
        context.lineWidth = width * unit;
        context.beginPath();
        context.moveTo(...at(from));
        context.lineTo(...at(to));
        context.stroke();
      }
    }
    for (let joint = 0; joint < points.length; joint++) {
      if (!known(joint)) continue;
      context.fillStyle = css(jointColour(side, joint));
      context.beginPath();
      context.arc(...at(joint), (joint === ROOT ? 4 : 2.8) * unit, 0, 2 * Math.PI);
      context.fill();
    }
    const known_points = points.filter((_, joint) => known(joint)) as [number, number][];
    if (known_points.length > 0) {
      const range = hand.range_m === null ? "?" : `${(100 * hand.range_m).toFixed(1)} cm`;
      const u = known_points.reduce((sum, point) => sum + point[0], 0) / known_points.length;
      const below = Math.max(...known_points.map((point) => point[1])) + 20 * unit;
      const above = Math.min(...known_points.map((point) => point[1])) - 10 * unit;
      const v = below < camera.height - 4 * unit ? below : above;
      this.write(`${side === "left" ? "L" : "R"} ${range}`, u, v, css(HAND_COLOURS[side]), camera, unit);
    }
    context.globalAlpha = 1;
  }

  private write(text: string, u: number, v: number, colour: string, camera: Camera, unit: number): void {
    const { context } = this;
    context.font = `600 ${15 * unit}px system-ui, sans-serif`;
    context.textAlign = "center";
    const half = context.measureText(text).width / 2 + 4 * unit;
    const x = Math.min(Math.max(u, half), camera.width - half);
    const y = Math.min(Math.max(v, 16 * unit), camera.height - 6 * unit);
    context.lineJoin = "round";
    context.lineWidth = 4 * unit;
    context.strokeStyle = "rgb(20 22 26 / 0.9)";
    context.strokeText(text, x, y);
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }
}
