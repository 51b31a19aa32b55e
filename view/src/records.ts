// Lines of hands.jsonl, version 2 (docs/video.md, *Files*): a header, then a line for each frame.

export type Side = "left" | "right";
export const SIDES: readonly Side[] = ["left", "right"];

export interface Hand {
  present: boolean;
  valid: boolean | null;
  score: number | null;
  joints_px: number[][] | null;
  joints_m: number[][] | null;
  range_m: number | null;
  range_sigma_m?: number | null;
  scale_source?: string | null;
  intrinsics_source?: string | null;
  method: string | null;
}

export interface Frame {
  index: number;
  time_s: number | null;
  hands: Record<Side, Hand>;
}

/** Intrinsics; pixels are counted from the outer corner of the first one. */
export interface Camera {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
}

export interface Header {
  version: number;
  source: string;
  weights: string;
  hand_length_m: number;
  camera: Camera;
  mirrored?: boolean;
}

export type Line = { header: Header } | { frame: Frame } | { measured: unknown };

/** A line of hands.jsonl, or of what the server says of measuring; null for an empty one. */
export function parseLine(text: string): Line | null {
  if (text.trim() === "") return null;
  const record = JSON.parse(text);
  if ("measured" in record) return record;
  return "version" in record ? { header: record as Header } : { frame: record as Frame };
}

/** What one hand's uncertainty of range is called, where the stream says it. */
export function sigma(hand: Hand): number | null {
  return hand.range_sigma_m ?? null;
}
