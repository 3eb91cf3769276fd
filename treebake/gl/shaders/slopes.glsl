// Slopes of a surface to a picture's right and up run from -STEEPEST to STEEPEST.
const float STEEPEST = 4.0;

// Of a texel of `relief`. A picture seen from behind, whose range of depths runs backwards, has those up reversed.
vec2 slopes_of(vec2 texel, vec2 range) {
    vec2 slopes = (texel * 2.0 - 1.0) * STEEPEST;
    return range.x > range.y ? vec2(slopes.x, -slopes.y) : slopes;
}
