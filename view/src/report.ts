// report.html: the lines, and a film of the pictures, lie in the file itself.

import { Page, element } from "./page";
import { type Frame, type Header, parseLine } from "./records";

export async function openReport(lines: string, film: string | null): Promise<void> {
  const page = new Page(
    `<button id="play">Play</button><input id="seek" type="range" min="0" value="0" aria-label="frame">
     <output id="at"></output>`,
    "",
    null,
  );
  let header: Header | null = null;
  const frames: Frame[] = [];
  for (const text of lines.split("\n")) {
    const line = parseLine(text);
    if (line !== null && "header" in line) header = line.header;
    else if (line !== null && "frame" in line) frames.push(line.frame);
  }
  const first = frames[0];
  if (header === null || first === undefined) {
    page.complain("This report holds no frames.");
    return;
  }
  page.begin(header);
  for (const frame of frames) page.plot.add(frame);
  page.say(facts(header, frames));
  new Player(page, frames, film === null ? null : await openFilm(film)).seek(0);
}

class Player {
  private at = -1;
  private readonly start: number;
  private clock: { since: number; from: number } | null = null;

  constructor(
    private readonly page: Page,
    private readonly frames: Frame[],
    private readonly film: HTMLVideoElement | null,
  ) {
    this.start = time(frames[0]!);
    const slider = element<HTMLInputElement>("seek");
    slider.max = `${frames.length - 1}`;
    slider.oninput = () => this.seek(Number(slider.value));
    element("play").onclick = () => this.toggle();
    const plot = document.querySelector<HTMLCanvasElement>("#ranges canvas")!;
    plot.classList.add("seekable");
    const seekTo = (event: PointerEvent) => this.seek(this.indexAt(page.plot.timeAt(event.offsetX)));
    plot.onpointerdown = (event) => {
      plot.setPointerCapture(event.pointerId);
      seekTo(event);
    };
    plot.onpointermove = (event) => event.buttons > 0 && seekTo(event);
    document.addEventListener("keydown", (event) => this.key(event));
    if (film !== null) {
      film.onseeked = () => this.paint();
      this.follow(film);
    }
  }

  seek(index: number): void {
    this.pause();
    this.at = Math.min(Math.max(index, 0), this.frames.length - 1);
    if (this.film === null) this.paint();
    // A little later than the picture's time, so that rounding does not show the one before.
    else this.film.currentTime = time(this.frames[this.at]!) - this.start + 0.002;
  }

  private toggle(): void {
    if (this.clock !== null) {
      this.pause();
      return;
    }
    if (this.at >= this.frames.length - 1) this.seek(0);
    this.clock = { since: performance.now(), from: time(this.frames[this.at]!) };
    element("play").textContent = "Pause";
    if (this.film === null) this.tick();
    else void this.film.play();
  }

  private pause(): void {
    this.clock = null;
    this.film?.pause();
    element("play").textContent = "Play";
  }

  /** Without a film: by the clock. */
  private tick(): void {
    if (this.clock === null) return;
    this.moveTo(this.clock.from + (performance.now() - this.clock.since) / 1000);
    requestAnimationFrame(() => this.tick());
  }

  /**
   * With a film: what it shows. A seek ends, on a busy machine, before the picture sought is there to be drawn; then it
   * is drawn over once it is.
   */
  private follow(film: HTMLVideoElement): void {
    film.requestVideoFrameCallback((_, about) => {
      this.follow(film);
      if (film.seeking) return; // what is shown is not yet what is sought
      const shown = this.start + about.mediaTime + 0.002;
      if (this.clock !== null) this.moveTo(shown);
      else if (this.indexAt(shown) === this.at) this.paint();
    });
    film.onended = () => this.clock !== null && this.moveTo(Infinity); // its last pictures may not have been seen
  }

  private moveTo(seconds: number): void {
    const at = this.indexAt(seconds);
    if (at !== this.at) {
      this.at = at;
      this.paint();
    }
    if (at === this.frames.length - 1) this.pause();
  }

  /** The last frame that is not later. */
  private indexAt(seconds: number): number {
    let low = 0;
    let high = this.frames.length - 1;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (time(this.frames[middle]!) <= seconds) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  private paint(): void {
    const frame = this.frames[this.at]!;
    this.page.show(this.film, frame);
    this.page.plot.mark(time(frame));
    element<HTMLInputElement>("seek").value = `${this.at}`;
    element("at").textContent = `${time(frame).toFixed(2)} s, frame ${frame.index}`;
  }

  private key(event: KeyboardEvent): void {
    if (event.target instanceof HTMLInputElement || event.target instanceof HTMLButtonElement) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === " ") this.toggle();
    else if (step !== undefined) this.seek(this.at + step);
    else return;
    event.preventDefault();
  }
}

function time(frame: Frame): number {
  return frame.time_s ?? frame.index / 30;
}

function facts(header: Header, frames: Frame[]): string {
  const seconds = time(frames[frames.length - 1]!) - time(frames[0]!);
  const found = (["left", "right"] as const).map(
    (side) => `${side} in ${frames.filter((frame) => frame.hands[side].present).length}`,
  );
  const rate = seconds > 0 ? `, ${((frames.length - 1) / seconds).toFixed(1)} a second` : "";
  const length = `hand length ${+(100 * header.hand_length_m).toFixed(2)} cm`;
  return `${frames.length} frames${rate} · ${found.join(", ")} · weights ${header.weights} · ${length}`;
}

async function openFilm(base64: string): Promise<HTMLVideoElement | null> {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const video = document.createElement("video");
  video.muted = true;
  video.playsInline = true;
  video.preload = "auto";
  video.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
  return new Promise((done) => {
    video.onloadeddata = () => done(video);
    video.onerror = () => done(null); // a browser without H.264: everything but the pictures
  });
}
