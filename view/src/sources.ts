// Pictures that this browser has: of its webcam, or of a video that was dropped on the page.

/** Longer side of pictures that are sent, pixels: the networks need no more, and what is more takes time. */
const LONG_SIDE = 960;
const QUALITY = 0.92;

export interface Grabbed {
  picture: OffscreenCanvas;
  jpeg: ArrayBuffer;
  timeS: number;
  takenMs: number;
}

export class Source {
  private constructor(
    readonly name: string,
    private readonly video: HTMLVideoElement,
    private readonly free: () => void,
    private readonly isFile: boolean,
  ) {}

  static async webcam(): Promise<Source> {
    if (navigator.mediaDevices === undefined) {
      throw new Error("This browser gives its camera only to pages from https or from this machine itself.");
    }
    const wanted = { width: { ideal: 960 }, height: { ideal: 540 }, frameRate: { ideal: 30 } };
    const stream = await navigator.mediaDevices.getUserMedia({ video: wanted, audio: false });
    const video = await playing((element) => (element.srcObject = stream));
    return new Source("webcam", video, () => stream.getTracks().forEach((track) => track.stop()), false);
  }

  static async file(file: File): Promise<Source> {
    const url = URL.createObjectURL(file);
    try {
      const video = await playing((element) => (element.src = url));
      return new Source(file.name, video, () => URL.revokeObjectURL(url), true);
    } catch {
      URL.revokeObjectURL(url);
      throw new Error(`${file.name}: this browser cannot play it; twohands track reads more kinds of video.`);
    }
  }

  get ended(): boolean {
    return this.isFile && this.video.ended;
  }

  /** The next picture that is shown; null where there is none within a second. */
  async grab(startedMs: number): Promise<Grabbed | null> {
    const mediaTime = await nextPicture(this.video);
    const { videoWidth, videoHeight } = this.video;
    if (mediaTime === null || videoWidth === 0) return null;
    const takenMs = performance.now();
    const scale = Math.min(1, LONG_SIDE / Math.max(videoWidth, videoHeight));
    // In memory, where the encoder reads it; and not toBlob, which waits for an idle page.
    const picture = new OffscreenCanvas(Math.round(videoWidth * scale), Math.round(videoHeight * scale));
    const context = picture.getContext("2d", { alpha: false, willReadFrequently: true })!;
    context.drawImage(this.video, 0, 0, picture.width, picture.height);
    const blob = await picture.convertToBlob({ type: "image/jpeg", quality: QUALITY });
    const seconds = this.isFile ? mediaTime : (takenMs - startedMs) / 1000;
    return { picture, jpeg: await blob.arrayBuffer(), timeS: Math.round(1e6 * seconds) / 1e6, takenMs };
  }

  stop(): void {
    this.video.pause();
    this.free();
  }
}

async function playing(fill: (video: HTMLVideoElement) => void): Promise<HTMLVideoElement> {
  const video = document.createElement("video");
  video.muted = true;
  video.playsInline = true;
  fill(video);
  await video.play();
  return video;
}

/** The time of the next picture, in its own clock; null after a second, or where the video has ended. */
function nextPicture(video: HTMLVideoElement): Promise<number | null> {
  return new Promise((done) => {
    const asked = video.requestVideoFrameCallback((_, about) => {
      clearTimeout(late);
      done(about.mediaTime);
    });
    const late = setTimeout(() => {
      video.cancelVideoFrameCallback(asked);
      done(null);
    }, 1000);
  });
}
