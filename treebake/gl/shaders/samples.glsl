// Where a pixel's 4 samples lie, from its centre: the standard pattern.
const vec2 SAMPLES[4] = vec2[](vec2(-0.125, -0.375), vec2(0.375, -0.125), vec2(-0.375, 0.125), vec2(0.125, 0.375));
