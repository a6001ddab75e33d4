// Colours: those of the page's style, and scales.

/** A colour of the style sheet, by its name without dashes. */
export function styled(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

const RAMP = [[0x3f, 0x78, 0xb5], [0x47, 0xa8, 0xa3], [0xe6, 0xc2, 0x5a], [0xee, 0x86, 0x45], [0xc9, 0x31, 0x4b]];

/** Colour of a share of the tension box, as three numbers from 0 to 1. */
export function ramp(share) {
  const x = Math.min(1, Math.max(0, share || 0)) * (RAMP.length - 1);
  const i = Math.min(RAMP.length - 2, Math.floor(x));
  return RAMP[i].map((low, k) => (low + (RAMP[i + 1][k] - low) * (x - i)) / 255);
}

export function css([r, g, b]) {
  return `rgb(${[r, g, b].map((c) => Math.round(255 * c)).join(" ")})`;
}

/** Colour of a segment, the same in the arm and in the plots; readable on light and on dark. */
export function segmentColour(segment) {
  return ["#2a9d8f", "#5b7fd1", "#d08a2e", "#b05cc0", "#5a9e3d", "#d0577a", "#2f93c4", "#98803a"][segment % 8];
}

/** Colours of the stages of a tick, in their order. */
export const STAGES = [
  ["input", "#7d8fa8"], ["estimate", "#5b7fd1"], ["plan", "#2a9d8f"], ["guard", "#d08a2e"], ["send", "#b05cc0"],
];

/** Colour of a mode: grey at rest, blue on the way, green at work, amber on hold, red in fault. */
export function modeColour(mode) {
  return ["#79858c", "#4a7fc1", "#b7791f", "#2f8f5b", "#4a7fc1", "#8d6bc4", "#c43d3d"][mode] ?? "#79858c";
}
