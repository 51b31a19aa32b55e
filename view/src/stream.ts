// The WebSocket of docs/stream.md: lines of hands.jsonl come, pictures and settings go.

import { type Frame, type Header, parseLine } from "./records";

export interface Settings {
  source: string;
  hand_length_m: number;
  fov_deg: number | null;
  mirrored: boolean;
  scale_source: string;
}

/** What the server says while it measures a hand at a taped distance. */
export interface Measured {
  frames: number;
  of: number;
  /** Whether it has come to an end, with a result or without. */
  over: boolean;
  problem: string | null;
  /** With the two below: what came of it; null before. */
  hand_length_m: number | null;
  fov_deg: number | null;
  /** Standard deviation of the hand length, as a share. */
  sigma: number | null;
}

export interface Listener {
  opened(): void;
  /** A header and its line, as it came. */
  header(header: Header, text: string): void;
  frame(frame: Frame, text: string): void;
  measured(measured: Measured): void;
  /** A picture of the next frame, and how old it was when it was sent, seconds. */
  picture(picture: ImageBitmap, timeS: number, ageS: number): void;
  /** @param lost whether the server is gone, rather than has refused something. */
  closed(reason: string, lost: boolean): void;
}

const CODES: Record<number, string> = {
  1006: "no answer from twohands live; is it running?",
  1009: "a message was too large",
};
const GOING = 1001;
const LOST = 1006;
/** Bytes before a picture's own: its time, and from the server its age, as little-endian doubles. */
const SENT_HEAD = 8;
const RECEIVED_HEAD = 16;

export class Stream {
  private readonly socket: WebSocket;
  /** Lines wait for the picture before them to be decoded. */
  private queue: Promise<void> = Promise.resolve();

  constructor(url: string, listener: Listener) {
    this.socket = new WebSocket(url);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => listener.opened();
    this.socket.onclose = ({ code, reason }) =>
      listener.closed(reason || CODES[code] || `closed (${code})`, code === GOING || code === LOST);
    this.socket.onmessage = (event) => {
      this.queue = this.queue.then(() => this.take(event.data, listener)).catch((error) => console.error(error));
    };
  }

  get open(): boolean {
    return this.socket.readyState === WebSocket.OPEN;
  }

  /** A new clip: what was before is forgotten. */
  begin(settings: Settings): void {
    this.socket.send(JSON.stringify({ begin: settings }));
  }

  /** One hand is held at a distance from the lens, metres; null: no more. */
  measure(distanceM: number | null): void {
    if (this.open) this.socket.send(JSON.stringify({ measure: { distance_m: distanceM } }));
  }

  /** The clip is over; another page may begin one. */
  end(): void {
    if (this.open) this.socket.send(JSON.stringify({ end: true }));
  }

  send(picture: ArrayBuffer, timeS: number): void {
    const message = new Uint8Array(SENT_HEAD + picture.byteLength);
    new DataView(message.buffer).setFloat64(0, timeS, true);
    message.set(new Uint8Array(picture), SENT_HEAD);
    this.socket.send(message);
  }

  close(): void {
    this.socket.close();
  }

  private async take(data: string | ArrayBuffer, listener: Listener): Promise<void> {
    if (typeof data === "string") {
      const line = parseLine(data);
      if (line === null) return;
      if ("measured" in line) listener.measured(line.measured as Measured);
      else if ("header" in line) listener.header(line.header, data);
      else listener.frame(line.frame, data);
    } else {
      const head = new DataView(data);
      const picture = await createImageBitmap(new Blob([data.slice(RECEIVED_HEAD)]));
      listener.picture(picture, head.getFloat64(0, true), head.getFloat64(8, true));
    }
  }
}
