// The page of `twohands live`: pictures go to the server, or come from its camera; lines come back.

import { Page, element } from "./page";
import type { Frame, Header } from "./records";
import { type Grabbed, Source } from "./sources";
import { type Measured, type Settings, Stream } from "./stream";
import { TapePanel, tapeHtml } from "./tape";

/** What the server says about itself. */
export interface LiveConfig {
  camera: string | null;
  hand_length_cm: number;
  fov_deg: number | null;
  mirrored: boolean;
  camera_file: boolean;
  scale_source: string;
  ours: boolean;
}

/** Seconds after which a picture without an answer is given up. */
const PATIENCE_S = 5;
/** Pictures that are kept for their answers. */
const KEPT = 3;
const PLOT_S = 10;

export function openLive(config: LiveConfig): void {
  new Live(config);
}

function toolsHtml(config: LiveConfig): string {
  const sources = config.camera === null
    ? `<button id="webcam" class="main">Use webcam</button>
       <label class="button">Open video<input id="file" type="file" accept="video/*" hidden></label>
       <button id="stop" disabled>Stop</button>`
    : "";
  const degrees = `min="10" max="170" step="any" placeholder="${config.camera_file ? "file" : "60"}"`;
  return `<div class="group">${sources}<button id="record" disabled>Record</button>
      <button id="calibrate" disabled aria-expanded="false" aria-controls="tape">Calibrate</button></div>
    <div class="group fields">
      <label title="0.6 times the length from the wrist's crease to the tip of the middle finger">Hand length
        <span><input id="length" type="number" min="4" max="20" step="any" required value="${config.hand_length_cm}"> cm</span></label>
      <label title="horizontal; 60 along the longer side if empty">Field of view
        <span><input id="fov" type="number" ${degrees} value="${config.fov_deg ?? ""}" ${config.camera_file ? "disabled" : ""}> °</span></label>
      <label title="as webcams often show you to yourself">Mirrored
        <input id="mirrored" type="checkbox" ${config.mirrored ? "checked" : ""}></label></div>
    ${tapeHtml()}`;
}

function welcomeHtml(config: LiveConfig): string {
  if (config.camera !== null) return `<p>Waiting for ${config.camera} of the machine that runs twohands live.</p>`;
  const local = ["127.0.0.1", "localhost", "[::1]"].includes(location.hostname);
  const whereto = local ? "Pictures stay on this machine." : `Pictures go to ${location.host} and nowhere else.`;
  // Until our weights see people from in front as well (README, docs/results.md).
  const other = config.ours
    ? `<p class="hint">Hands of people in front of the camera are found more surely with
       <code>twohands live --estimator mediapipe</code>: it finds them, we give the metres.</p>`
    : "";
  return `<p><strong>Use your webcam, or drop a video here</strong></p><p>${whereto}</p>${other}`;
}

class Live {
  private readonly page: Page;
  private stream: Stream | null = null;
  private source: Source | null = null;
  private header: Header | null = null;
  /** The last pictures that were sent, newest last: a late answer may be to one before. */
  private sent: Grabbed[] = [];
  private answered: (() => void) | null = null;
  private picture: { image: ImageBitmap; ageS: number; atMs: number } | null = null;
  private arrivals: number[] = [];
  private delays: number[] = [];
  private record: string[] | null = null;
  private lastHeader = "";
  private lost = false;
  private scaleSource: string;
  private readonly tape: TapePanel;
  private before: { length: string; fov: string; scaleSource: string } | null = null;
  /** Milliseconds that the last answer has taken, and the last picture. */
  private answerMs = 0;
  private grabMs = 0;

  constructor(private readonly config: LiveConfig) {
    this.page = new Page(toolsHtml(config), welcomeHtml(config), PLOT_S);
    element("record").onclick = () => this.toggleRecord();
    this.scaleSource = config.scale_source;
    this.tape = new TapePanel(
      (metres) => this.stream?.measure(metres),
      () => this.goBack(),
    );
    element("length").onchange = () => this.changed("typed");
    // A length from a taped distance holds with its field of view alone.
    element("fov").onchange = () => this.changed(this.scaleSource === "distance" ? "assumed" : this.scaleSource);
    element("mirrored").onchange = () => this.changed(this.scaleSource);
    if (config.camera === null) {
      element("webcam").onclick = () => void this.start(() => Source.webcam());
      element("stop").onclick = () => this.stop();
      element<HTMLInputElement>("file").onchange = (event) => {
        const input = event.target as HTMLInputElement;
        const file = input.files?.[0];
        if (file) void this.start(() => Source.file(file));
        input.value = "";
      };
      this.acceptDrops();
    }
    this.connect();
    setInterval(() => this.sayFacts(), 500);
  }

  private connect(): void {
    const token = new URLSearchParams(location.search).get("token");
    const query = new URLSearchParams({ pictures: "1", ...(token === null ? {} : { token }) });
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.stream = new Stream(`${scheme}://${location.host}/stream?${query}`, {
      opened: () => this.lost && this.page.complain(""),
      header: (header, text) => this.begun(header, text),
      frame: (frame, text) => this.took(frame, text),
      measured: (said) => this.measured(said),
      picture: (image, _, ageS) => (this.picture = { image, ageS, atMs: performance.now() }),
      closed: (reason, lost) => this.closed(reason, lost),
    });
  }

  private closed(reason: string, lost: boolean): void {
    this.stop();
    this.lost = lost;
    this.page.complain(`${reason[0]?.toUpperCase() ?? ""}${reason.slice(1)}${/[.?!]$/.test(reason) ? "" : "."}`);
    setTimeout(() => this.connect(), 3000);
  }

  private begun(header: Header, text: string): void {
    this.header = header;
    this.lastHeader = text;
    this.arrivals = [];
    this.delays = [];
    if (this.record !== null) {
      // A file has one header: each clip has its own.
      if (this.record.length > 1) save(this.record);
      this.record = [text];
    }
    this.page.begin(header);
    element<HTMLButtonElement>("record").disabled = false;
    this.tape.enable(this.record === null);
    if (this.config.camera_file) {
      const { fx, cx, width } = header.camera;
      const degrees = (180 / Math.PI) * (Math.atan(cx / fx) + Math.atan((width - cx) / fx));
      element<HTMLInputElement>("fov").value = degrees.toFixed(1);
    }
  }

  private took(frame: Frame, text: string): void {
    if (this.header === null) return;
    const now = performance.now();
    this.arrivals = [...this.arrivals.filter((at, i, all) => at > now - 2000 || i >= all.length - 3), now];
    const own = this.sent.find(({ timeS }) => frame.time_s !== null && Math.abs(timeS - frame.time_s) < 1e-4);
    if (own !== undefined) {
      this.delays.push(now - own.takenMs);
      this.page.show(own.picture, frame);
      this.answered?.();
    } else {
      if (this.picture !== null) this.delays.push(1000 * this.picture.ageS + now - this.picture.atMs);
      this.page.show(this.picture?.image ?? null, frame);
    }
    this.delays = this.delays.slice(-30);
    this.page.plot.add(frame);
    this.record?.push(text);
  }

  private settings(source: string): Settings | null {
    const centimetres = element<HTMLInputElement>("length").valueAsNumber;
    const degrees = element<HTMLInputElement>("fov").value;
    for (const id of ["length", "fov"]) {
      const input = element<HTMLInputElement>(id);
      if (!input.disabled && !input.reportValidity()) return null;
    }
    if (!Number.isFinite(centimetres)) return null;
    return {
      source,
      hand_length_m: Math.round(1e4 * centimetres) / 1e6,
      fov_deg: degrees === "" || this.config.camera_file ? null : Number(degrees),
      mirrored: element<HTMLInputElement>("mirrored").checked,
      scale_source: this.scaleSource,
    };
  }

  private changed(scaleSource: string): void {
    this.scaleSource = scaleSource;
    const source = this.config.camera ?? this.source?.name;
    if (source === undefined || !this.stream?.open) return;
    const settings = this.settings(source);
    if (settings === null) return;
    // Until the new clip is there: what is asked now would be of the old one.
    this.tape.enable(false);
    element<HTMLButtonElement>("record").disabled = true;
    this.stream.begin(settings);
  }

  /** The server has begun a new clip already when there is a result. */
  private measured(said: Measured): void {
    if (said.hand_length_m === null || said.sigma === null) {
      this.tape.progress(said);
      return;
    }
    const [length, fov] = [element<HTMLInputElement>("length"), element<HTMLInputElement>("fov")];
    this.before = { length: length.value, fov: fov.value, scaleSource: this.scaleSource };
    this.scaleSource = "distance";
    length.value = (100 * said.hand_length_m).toFixed(2);
    if (!this.config.camera_file && said.fov_deg !== null) fov.value = `${said.fov_deg}`;
    const view = said.fov_deg === null || this.config.camera_file ? "" : `, field of view ${said.fov_deg.toFixed(0)}°`;
    const centimetres = `${(100 * said.hand_length_m).toFixed(1)} ± ${(100 * said.hand_length_m * said.sigma).toFixed(1)} cm`;
    // Of the hand that was measured, and of each that will be.
    const right = Math.hypot(said.sigma, said.sigma);
    this.tape.done(`Hand length ${centimetres}${view}. Ranges are now right to about ${(100 * right).toFixed(0)} %.`);
  }

  private goBack(): void {
    if (this.before === null) return;
    element<HTMLInputElement>("length").value = this.before.length;
    if (!this.config.camera_file) element<HTMLInputElement>("fov").value = this.before.fov;
    this.changed(this.before.scaleSource);
  }

  private async start(open: () => Promise<Source>): Promise<void> {
    this.stop();
    this.page.complain("");
    try {
      this.source = await open();
    } catch (error) {
      const refused = error instanceof DOMException && error.name === "NotAllowedError";
      this.page.complain(refused ? "The browser was not allowed to use the camera." : `${(error as Error).message}`);
      return;
    }
    const settings = this.settings(this.source.name);
    if (settings === null || !this.stream?.open) {
      this.stop();
      return;
    }
    this.stream.begin(settings);
    element<HTMLButtonElement>("stop").disabled = false;
    await this.run(this.source, this.stream);
  }

  /** One picture in flight. The next one is taken just before the answer to the last one is expected: neither side
   *  waits for the other, and the picture is fresh. */
  private async run(source: Source, stream: Stream): Promise<void> {
    const startedMs = performance.now();
    let next = this.grab(source, startedMs, 0);
    while (this.source === source && stream.open) {
      const grabbed = await next;
      if (grabbed === null) {
        if (source.ended) break;
        next = this.grab(source, startedMs, 0);
        continue;
      }
      if (this.source !== source || !stream.open) break;
      const sentMs = performance.now();
      const answer = new Promise<void>((done) => {
        this.answered = done;
        setTimeout(done, 1000 * PATIENCE_S);
      });
      this.sent = [...this.sent.slice(1 - KEPT), grabbed];
      stream.send(grabbed.jpeg, grabbed.timeS);
      next = this.grab(source, startedMs, this.answerMs - this.grabMs);
      await answer;
      this.answerMs = performance.now() - sentMs;
    }
    if (this.source === source) this.stop();
  }

  private async grab(source: Source, startedMs: number, waitMs: number): Promise<Grabbed | null> {
    if (waitMs > 0) await new Promise((done) => setTimeout(done, waitMs));
    if (this.source !== source) return null;
    const sinceMs = performance.now();
    const grabbed = await source.grab(startedMs);
    this.grabMs = performance.now() - sinceMs;
    return grabbed;
  }

  private stop(): void {
    if (this.source === null) return;
    this.source.stop();
    this.source = null;
    this.sent = [];
    this.answered?.();
    if (this.record !== null) this.toggleRecord();
    this.tape.enable(false);
    this.stream?.end();
    element<HTMLButtonElement>("stop").disabled = true;
    element<HTMLButtonElement>("record").disabled = true;
  }

  private toggleRecord(): void {
    const button = element<HTMLButtonElement>("record");
    const recording = this.record === null;
    if (this.record !== null) save(this.record);
    this.record = recording ? [this.lastHeader] : null;
    button.classList.toggle("on", recording);
    button.textContent = recording ? "Stop and save" : "Record";
    this.tape.enable(!recording);
    // One clip has one header: what is in it stays while it is recorded.
    for (const id of ["length", "fov", "mirrored"]) {
      element<HTMLInputElement>(id).disabled = recording || (id === "fov" && this.config.camera_file);
    }
  }

  private acceptDrops(): void {
    const box = document.body;
    box.addEventListener("dragover", (event) => {
      event.preventDefault();
      box.classList.add("drop");
    });
    for (const name of ["dragleave", "drop"]) box.addEventListener(name, () => box.classList.remove("drop"));
    box.addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file) void this.start(() => Source.file(file));
    });
  }

  private sayFacts(): void {
    const [first, last] = [this.arrivals[0], this.arrivals[this.arrivals.length - 1]];
    const idle = last === undefined || performance.now() > last + 1000 * PATIENCE_S;
    if (idle || first === undefined || last === first) {
      this.page.say(this.stream?.open ? "ready" : "");
      return;
    }
    const rate = (1000 * (this.arrivals.length - 1)) / (last - first);
    const delay = [...this.delays].sort((a, b) => a - b)[Math.floor(this.delays.length / 2)];
    const late = delay === undefined ? "" : ` · delay ${Math.round(delay)} ms`;
    const kept = this.record === null ? "" : ` · ${this.record.length - 1} frames recorded`;
    this.page.say(`${rate.toFixed(1)} fps${late}${kept}`);
  }
}

function save(lines: string[]): void {
  const url = URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "application/x-ndjson" }));
  Object.assign(document.createElement("a"), { href: url, download: "hands.jsonl" }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
