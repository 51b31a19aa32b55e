// Range over time, with one sigma where the stream says it.

import { type Frame, SIDES, type Side, sigma } from "./records";
import { HAND_COLOURS, css } from "./skeleton";

interface Sample {
  time: number;
  range: number | null;
  sigma: number | null;
  predicted: boolean;
}

const STEPS_CM = [1, 2, 5, 10, 20, 50, 100, 200];
const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600, 1800];

export class RangePlot {
  private readonly context: CanvasRenderingContext2D;
  private series: Record<Side, Sample[]> = { left: [], right: [] };
  private waiting = false;
  private cursor: number | null = null;

  /**
   * @param window seconds that are shown; null for all.
   * @param inMemory draw there, rather than by the graphics card.
   */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly window: number | null,
    inMemory: boolean,
  ) {
    this.context = canvas.getContext("2d", { willReadFrequently: inMemory })!;
    new ResizeObserver(() => this.ask()).observe(canvas);
  }

  clear(): void {
    this.series = { left: [], right: [] };
    this.ask();
  }

  add(frame: Frame): void {
    const time = frame.time_s ?? frame.index;
    for (const side of SIDES) {
      const hand = frame.hands[side];
      const series = this.series[side];
      series.push({ time, range: hand.range_m, sigma: sigma(hand), predicted: hand.method === "predicted" });
      while (this.window !== null && series.length > 1 && series[1]!.time < time - this.window) series.shift();
    }
    this.ask();
  }

  /** Marks a time. */
  mark(time: number): void {
    this.cursor = time;
    this.ask();
  }

  /** The time under a place of the canvas, CSS pixels from its left. */
  timeAt(x: number): number {
    const [first, last] = this.times();
    const [left, right] = this.edges();
    return first + ((last - first) * Math.min(Math.max(x - left, 0), right - left)) / (right - left);
  }

  private ask(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  private times(): [number, number] {
    const series = this.series.left;
    const last = series[series.length - 1]?.time ?? 0;
    const first = this.window === null ? (series[0]?.time ?? 0) : last - this.window;
    return [first, Math.max(last, first + 0.1)];
  }

  private edges(): [number, number] {
    return [34, this.canvas.clientWidth - 4];
  }

  private ranges(): [number, number] {
    const all = SIDES.flatMap((side) => this.series[side]).filter((sample) => sample.range !== null);
    if (all.length === 0) return [0, 100];
    const low = Math.min(...all.map((sample) => 100 * (sample.range! - (sample.sigma ?? 0))));
    const high = Math.max(...all.map((sample) => 100 * (sample.range! + (sample.sigma ?? 0))));
    const margin = Math.max(2, 0.12 * (high - low));
    return [Math.max(0, low - margin), high + margin];
  }

  private draw(): void {
    const { canvas, context } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (width === 0) return;
    canvas.width = Math.round(width * devicePixelRatio);
    canvas.height = Math.round(height * devicePixelRatio);
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    const [first, last] = this.times();
    const [low, high] = this.ranges();
    const [left, right] = this.edges();
    const [top, bottom] = [10, height - 24];
    const x = (time: number) => left + ((right - left) * (time - first)) / (last - first);
    const y = (cm: number) => bottom - ((bottom - top) * (cm - low)) / (high - low);
    this.axes(x, y, [first, last], [low, high]);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    for (const side of SIDES) this.band(side, x, y);
    for (const side of SIDES) this.curve(side, x, y);
    if (this.cursor !== null) {
      context.strokeStyle = "#e8eaee";
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(x(this.cursor), top);
      context.lineTo(x(this.cursor), bottom);
      context.stroke();
    }
    context.restore();
  }

  private axes(
    x: (time: number) => number,
    y: (cm: number) => number,
    [first, last]: [number, number],
    [low, high]: [number, number],
  ): void {
    const { context, canvas } = this;
    const [left, right] = this.edges();
    const bottom = canvas.clientHeight - 24;
    const stepCm = STEPS_CM.find((step) => (high - low) / step <= 5) ?? 500;
    const stepS = STEPS_S.find((step) => (last - first) / step <= canvas.clientWidth / 90) ?? 3600;
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = "#9aa2af";
    context.strokeStyle = "#2c313a";
    context.lineWidth = 1;
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let cm = Math.ceil(low / stepCm) * stepCm; cm <= high; cm += stepCm) {
      context.beginPath();
      context.moveTo(left, y(cm));
      context.lineTo(right, y(cm));
      context.stroke();
      context.fillText(`${cm}`, left - 6, y(cm));
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (let time = Math.ceil(first / stepS) * stepS; time <= last; time += stepS) {
      if (time < 0) continue;
      context.fillText(`${+time.toFixed(1)} s`, Math.min(Math.max(x(time), left + 8), right - 12), bottom + 7);
    }
    if (!SIDES.some((side) => this.series[side].some((sample) => sample.range !== null))) {
      context.fillText("No hand yet", (left + right) / 2, bottom / 2);
    }
  }

  /** Pieces of a hand's curve between its absences. */
  private pieces(side: Side): Sample[][] {
    const pieces: Sample[][] = [[]];
    for (const sample of this.series[side]) {
      if (sample.range !== null) pieces[pieces.length - 1]!.push(sample);
      else if (pieces[pieces.length - 1]!.length > 0) pieces.push([]);
    }
    return pieces.filter((piece) => piece.length > 0);
  }

  private band(side: Side, x: (time: number) => number, y: (cm: number) => number): void {
    const { context } = this;
    context.fillStyle = css(HAND_COLOURS[side], 0.18);
    for (const piece of this.pieces(side)) {
      const known = piece.filter((sample) => sample.sigma !== null);
      if (known.length < 2) continue;
      context.beginPath();
      for (const sample of known) context.lineTo(x(sample.time), y(100 * (sample.range! + sample.sigma!)));
      for (const sample of known.reverse()) context.lineTo(x(sample.time), y(100 * (sample.range! - sample.sigma!)));
      context.fill();
    }
  }

  private curve(side: Side, x: (time: number) => number, y: (cm: number) => number): void {
    const { context } = this;
    context.lineWidth = 2;
    context.lineJoin = "round";
    for (const piece of this.pieces(side)) {
      for (const predicted of [false, true]) {
        context.strokeStyle = css(HAND_COLOURS[side], predicted ? 0.5 : 1);
        context.setLineDash(predicted ? [3, 3] : []);
        context.beginPath();
        piece.forEach((sample, i) => {
          const before = piece[i - 1];
          const draws = before !== undefined && sample.predicted === predicted;
          if (draws) {
            context.moveTo(x(before.time), y(100 * before.range!));
            context.lineTo(x(sample.time), y(100 * sample.range!));
          }
        });
        context.stroke();
      }
      if (piece.length === 1) {
        context.fillStyle = css(HAND_COLOURS[side]);
        context.fillRect(x(piece[0]!.time) - 1.5, y(100 * piece[0]!.range!) - 1.5, 3, 3);
      }
    }
    context.setLineDash([]);
  }
}
