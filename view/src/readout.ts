// Numbers beside the pictures: a tile for each hand, and all joints in millimetres.

import { type Frame, type Hand, SIDES, type Side, sigma } from "./records";
import { JOINT_NAMES, ROOT } from "./skeleton";

const WORDS: Record<Side, string> = { left: "Left", right: "Right" };

export function tilesHtml(): string {
  return SIDES.map(
    (side) => `<div class="tile ${side}" id="tile-${side}">
      <span class="name">${WORDS[side]}</span>
      <span class="value"><span class="range">–</span> <span class="sigma"></span></span>
      <span class="about">not seen</span>
    </div>`,
  ).join("");
}

export function jointsHtml(): string {
  const rows = JOINT_NAMES.map(
    (name, joint) => `<tr><th scope="row">${joint} ${name}</th>${"<td></td>".repeat(6)}</tr>`,
  );
  return `<table id="joints"><thead>
    <tr><th scope="col" rowspan="2">Joint</th><th scope="colgroup" colspan="3" class="left">Left, mm</th>
    <th scope="colgroup" colspan="3" class="right">Right, mm</th></tr>
    <tr>${"<th scope='col'>x</th><th scope='col'>y</th><th scope='col'>z</th>".repeat(2)}</tr>
    </thead><tbody>${rows.join("")}</tbody></table>`;
}

export class Readout {
  private readonly cells: HTMLTableCellElement[];
  private readonly table: HTMLTableElement;
  private readonly details: HTMLDetailsElement;
  private readonly apart: HTMLElement;
  private readonly assumed: HTMLElement;
  private last: Frame | null = null;

  constructor(page: Document) {
    this.table = page.querySelector<HTMLTableElement>("#joints")!;
    this.cells = [...this.table.querySelectorAll("td")];
    this.details = this.table.closest("details")!;
    this.apart = page.querySelector("#apart")!;
    this.assumed = page.querySelector("#assumed")!;
    this.details.addEventListener("toggle", () => this.last !== null && this.show(this.last));
  }

  show(frame: Frame): void {
    this.last = frame;
    for (const side of SIDES) showTile(document.querySelector(`#tile-${side}`)!, frame.hands[side]);
    const [left, right] = SIDES.map((side) => frame.hands[side].joints_m?.[ROOT]);
    this.apart.textContent = left && right ? `${centimetres(distance(left, right))} cm apart` : "";
    const words = assumed(frame);
    this.assumed.hidden = words === "";
    this.assumed.textContent = words;
    if (this.details.open) this.showJoints(frame);
  }

  private showJoints(frame: Frame): void {
    this.table.dataset.index = `${frame.index}`;
    this.table.dataset.time = `${frame.time_s ?? ""}`;
    JOINT_NAMES.forEach((_, joint) => {
      SIDES.forEach((side, place) => {
        for (let axis = 0; axis < 3; axis++) {
          const value = frame.hands[side].joints_m?.[joint]?.[axis];
          this.cells[6 * joint + 3 * place + axis]!.textContent = value == null ? "–" : (1000 * value).toFixed(1);
        }
      });
    });
  }
}

function showTile(tile: HTMLElement, hand: Hand): void {
  const spread = sigma(hand);
  const set = (name: string, text: string) => (tile.querySelector(`.${name}`)!.textContent = text);
  tile.classList.toggle("absent", !hand.present);
  set("range", hand.range_m === null ? "–" : `${centimetres(hand.range_m)} cm`);
  set("sigma", hand.range_m === null || spread === null ? "" : `± ${centimetres(spread)}`);
  set("about", about(hand));
}

function about(hand: Hand): string {
  if (!hand.present) return "not seen";
  if (hand.method === "predicted") return "carried on";
  if (hand.range_m === null) return "seen, not placed";
  return hand.score === null ? "seen" : `seen, ${Math.round(100 * hand.score)} % sure`;
}

/** What the standard deviations of a frame allow for. */
function assumed(frame: Frame): string {
  const placed = SIDES.map((side) => frame.hands[side]).filter((hand) => hand.range_m !== null && sigma(hand) !== null);
  const length = placed.some((hand) => hand.scale_source === "assumed");
  // A taped distance makes up for the camera.
  const camera = placed.some((hand) => hand.intrinsics_source === "assumed" && hand.scale_source !== "distance");
  if (!length && !camera) return "";
  return `± allows for an assumed ${length && camera ? "hand length and camera" : length ? "hand length" : "camera"}`;
}

function centimetres(metres: number): string {
  return (100 * metres).toFixed(1);
}

function distance(a: readonly number[], b: readonly number[]): number {
  return Math.hypot(...a.map((value, axis) => value - b[axis]!));
}
