// What both kinds of page have in common: picture, space, plot and numbers.

import { Overlay, type Picture } from "./overlay";
import { RangePlot } from "./plot";
import { Readout, jointsHtml, tilesHtml } from "./readout";
import type { Frame, Header } from "./records";
import { Space } from "./space";
import style from "./style.css";

export function element<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

export class Page {
  readonly plot: RangePlot;
  private readonly overlay: Overlay;
  private readonly readout: Readout;
  private readonly space: Space | null;
  private header: Header | null = null;
  private last: [Picture | null, Frame] | null = null;

  /**
   * @param tools what stands above the pictures.
   * @param welcome what stands in the picture's place before there is one.
   * @param window seconds of the plot; null for all.
   */
  constructor(tools: string, welcome: string, window: number | null) {
    document.head.append(Object.assign(document.createElement("style"), { textContent: style }));
    document.body.innerHTML = `
      <header><h1>twohands</h1><span id="source"></span><span id="facts" role="status"></span></header>
      <p id="message" role="alert" hidden></p>
      <section id="tools">${tools}</section>
      <main>
        <section id="picture" aria-label="picture with both hands"><canvas hidden></canvas><div id="welcome">${welcome}</div></section>
        <section id="space" aria-label="both hands in space"><nav>
          <button data-from="side">Side</button><button data-from="camera">Camera</button>
          <button data-from="above">Above</button></nav></section>
        <section id="numbers">${tilesHtml()}<p id="apart"></p><p id="assumed" hidden></p></section>
        <section id="ranges" aria-label="range over time"><h2>Range over time <span>cm, with one sigma</span></h2><canvas></canvas></section>
      </main>
      <details><summary>Joints, in the camera's frame: x right, y down, z forward</summary>
        <div class="wide">${jointsHtml()}</div></details>`;
    this.readout = new Readout(document);
    const slow = !hasGraphicsCard();
    this.overlay = new Overlay(document.querySelector("#picture canvas")!, slow);
    this.plot = new RangePlot(document.querySelector("#ranges canvas")!, window, slow);
    this.space = openSpace(element("space"), slow);
    for (const button of document.querySelectorAll<HTMLButtonElement>("#space [data-from]")) {
      button.onclick = () => this.space?.lookFrom(button.dataset.from as "side" | "camera" | "above");
    }
    new ResizeObserver(() => this.repaint()).observe(element("picture"));
  }

  /** A new clip. */
  begin(header: Header): void {
    this.header = header;
    this.plot.clear();
    this.space?.setCamera(header.camera);
    element("source").textContent = header.source.split(/[\\/]/).pop() || header.source;
    element("source").title = header.source;
    element("picture").style.setProperty("--shape", `${header.camera.width} / ${header.camera.height}`);
  }

  show(picture: Picture | null, frame: Frame): void {
    if (this.header === null) return;
    element("welcome").hidden = true;
    document.querySelector<HTMLCanvasElement>("#picture canvas")!.hidden = false;
    this.last = [picture, frame];
    this.repaint();
    this.space?.draw(frame);
    this.readout.show(frame);
  }

  /** A line of facts beside the source's name. */
  say(facts: string): void {
    // Unchanged text that is set again would be drawn again.
    if (element("facts").textContent !== facts) element("facts").textContent = facts;
  }

  /** What has gone wrong; an empty text takes it away. */
  complain(text: string): void {
    element("message").textContent = text;
    element("message").hidden = text === "";
  }

  private repaint(): void {
    if (this.header === null || this.last === null) return;
    this.overlay.draw(this.last[0], this.header.camera, this.last[1], this.header.mirrored ?? false);
  }
}

/** Where there is none, drawing through WebGL's emulation costs many times what drawing in memory does. */
function hasGraphicsCard(): boolean {
  const context = document.createElement("canvas").getContext("webgl");
  if (context === null) return false;
  const names = context.getExtension("WEBGL_debug_renderer_info");
  const name = names === null ? "" : `${context.getParameter(names.UNMASKED_RENDERER_WEBGL)}`;
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|software|basic render/i.test(name);
}

function openSpace(box: HTMLElement, slow: boolean): Space | null {
  try {
    return new Space(box, slow);
  } catch (error) {
    box.append(Object.assign(document.createElement("p"), { textContent: "This browser has no WebGL: no view in space." }));
    console.error(error);
    return null;
  }
}
