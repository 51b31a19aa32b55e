// The panel for a hand at a taped distance: asks for it, says how the measuring goes, and what came of it.

import { element } from "./page";
import type { Measured } from "./stream";

export function tapeHtml(): string {
  return `<form id="tape" hidden>
    <p><strong>Calibrate with a tape</strong> Hold one open hand so that its middle knuckle is at a measured distance from
      the lens. Keep that distance and move it slowly across the picture.</p>
    <div><label>Distance <input id="distance" type="number" min="10" max="500" step="0.5" value="50" required> cm</label>
      <button id="measure" class="main" type="submit">Measure</button>
      <button id="undo" type="button" hidden>Undo</button></div>
    <div id="tape-says" hidden><progress id="taken" value="0" max="1"></progress><output id="tape-text"></output></div>
  </form>`;
}

export class TapePanel {
  private readonly opener = element<HTMLButtonElement>("calibrate");
  private readonly form = element<HTMLFormElement>("tape");
  private measuring = false;

  /**
   * @param measure is called with metres, and with null to stop.
   * @param undo is called to go back to what was before.
   */
  constructor(
    private readonly measure: (metres: number | null) => void,
    undo: () => void,
  ) {
    this.opener.onclick = () => this.toggle();
    this.form.onsubmit = (event) => {
      event.preventDefault();
      this.measure(element<HTMLInputElement>("distance").valueAsNumber / 100);
      this.busy(true);
      this.say("Looking for one hand…", 0);
    };
    element("undo").onclick = () => {
      element("undo").hidden = true;
      element("tape-says").hidden = true;
      undo();
    };
  }

  /** Whether there is a clip in which a hand can be measured, and another one may begin; what measures now ends. */
  enable(on: boolean): void {
    this.opener.disabled = !on;
    element<HTMLButtonElement>("undo").disabled = !on;
    this.stop();
  }

  /** One more frame without an end yet, or the end without a result; nothing where one on its way is of no use. */
  progress(said: Measured): void {
    if (!this.measuring) return;
    this.busy(!said.over);
    const count = `${said.frames} of ${said.of} frames`;
    this.say(said.problem === null ? count : `${count}: ${said.problem}`, said.frames / said.of, said.over);
  }

  done(text: string): void {
    this.busy(false);
    this.say(text, null);
    element("undo").hidden = false;
  }

  private toggle(): void {
    this.form.hidden = !this.form.hidden;
    this.opener.setAttribute("aria-expanded", `${!this.form.hidden}`);
    if (this.form.hidden) this.stop();
    else element("distance").focus();
  }

  private stop(): void {
    if (this.measuring) {
      this.measure(null);
      element("tape-says").hidden = true;
    }
    this.busy(false);
  }

  private busy(on: boolean): void {
    this.measuring = on;
    element<HTMLButtonElement>("measure").disabled = on || this.opener.disabled;
    element<HTMLInputElement>("distance").disabled = on;
  }

  private say(text: string, share: number | null, failed = false): void {
    element("tape-says").hidden = false;
    element("tape-says").classList.toggle("failed", failed);
    element("taken").hidden = share === null || failed;
    element<HTMLProgressElement>("taken").value = share ?? 1;
    element("tape-text").textContent = text;
  }
}
