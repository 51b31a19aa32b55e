// The hand's bones and colours, as src/twohands/skeleton.py and visualization/palette.py have them.

import type { Side } from "./records";

export const JOINT_NAMES = [
  "wrist",
  ...["thumb", "index", "middle", "ring", "little"].flatMap((finger) => [1, 2, 3, 4].map((i) => `${finger} ${i}`)),
];
export const PARENTS = [-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19];
export const ROOT = 9;
/** (parent, child) of the 20 bones. */
export const BONES: readonly (readonly [number, number])[] = PARENTS.flatMap((parent, child) =>
  parent < 0 ? [] : [[parent, child] as const],
);

export type Rgb = readonly [number, number, number];
export const HAND_COLOURS: Record<Side, Rgb> = { left: [86, 180, 233], right: [230, 159, 0] };
const SHADES = [0.5, 0.25, 0.0, -0.22, -0.44];

/** Colour of a joint, and of the bone that ends in it: thumb light, little finger dark. */
export function jointColour(side: Side, joint: number): Rgb {
  const base = HAND_COLOURS[side];
  if (joint === 0) return base;
  const shade = SHADES[Math.floor((joint - 1) / 4)] ?? 0;
  const target = shade > 0 ? 255 : 0;
  const mix = (value: number) => Math.round((1 - Math.abs(shade)) * value + Math.abs(shade) * target);
  return [mix(base[0]), mix(base[1]), mix(base[2])];
}

export function css(colour: Rgb, alpha = 1): string {
  return `rgb(${colour[0]} ${colour[1]} ${colour[2]} / ${alpha})`;
}
