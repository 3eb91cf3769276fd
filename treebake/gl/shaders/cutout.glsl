// The 4x4 ordered dither: as many of 16 neighbouring samples lie below a share as the share says.
const float BAYER[16] = float[](0., 8., 2., 10., 12., 4., 14., 6., 3., 11., 1., 9., 15., 7., 13., 5.);

uniform float alpha_cutoff;  // 0 where the material is opaque
uniform bool blend;          // alpha is a share: it decides how many of a texel's samples are covered

// Whether a sample of this alpha is left out.
bool cut_out(float alpha) {
    ivec2 cell = ivec2(gl_FragCoord.xy) & 3;
    return alpha < (blend ? (BAYER[cell.y * 4 + cell.x] + 0.5) / 16.0 : alpha_cutoff);
}
