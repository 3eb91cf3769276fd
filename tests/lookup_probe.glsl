// Shows what indirect_lookup.glsl finds at each pixel's centre: placement + 1, texture coordinates, ray parameter.
#include "indirect_box.glsl"

#ifdef FRAGMENT_STAGE
#include "indirect_lookup.glsl"

uniform mat4 from_clip;
uniform vec2 window;
uniform float share;
uniform float dither;

flat in int billboard;
out vec4 found;

vec3 unprojected(vec3 place) {
    vec4 point = from_clip * vec4(place, 1.0);
    return point.xyz / point.w;
}

void main() {
    Billboard board = read_billboard(billboard);
    vec2 place = gl_FragCoord.xy / window * 2.0 - 1.0;
    vec3 near = unprojected(vec3(place, -1.0));
    vec3 far = unprojected(vec3(place, 1.0));
    vec3 aside = vec3(1.0 / window.x, 0.0, 0.0);
    vec2 spread = vec2(length(unprojected(vec3(place, 1.0) + aside) - far), length(unprojected(vec3(place, -1.0) + aside) - near));
    Hit hit = look_up(board, board.turn * near + board.shift, board.turn * (far - near), spread * length(board.turn[0]),
                      share, dither);
    if (hit.placement < 0) discard;
    gl_FragDepth = clamp(hit.along, 0.0, 1.0);
    found = vec4(float(hit.placement + 1), hit.uv, hit.along);
}
#endif
