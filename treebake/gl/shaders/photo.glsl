// Photographs a mesh for a picture that stands in for it: what it takes to light it where it stands. Cut-outs are tested
// unfiltered, as if leaves were modelled: mips thin what is cut out and mix in what lies under it.
#ifdef VERTEX_STAGE
uniform mat4 to_clip;  // a parallel projection; rows run downwards in the picture, so it is upside down

in vec3 in_position;
in vec3 in_normal;
in vec2 in_uv;
in float in_occlusion;

out vec3 position;
out vec3 normal;
out vec2 uv;
out float occlusion;

void main() {
    position = in_position;
    normal = in_normal;
    uv = in_uv;
    occlusion = in_occlusion;
    gl_Position = to_clip * vec4(in_position, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
uniform mat3 turn;   // to the picture's frame: right, up, towards the viewer
uniform vec2 slab;   // what lies outside, along the way to the viewer, is left out
uniform vec2 range;  // along the way to the viewer, that the picture's depth of 0..1 stands for
uniform vec4 base_color;
uniform sampler2D color_map;
uniform sampler2D normal_map;
uniform bool has_normal_map;

in vec3 position;
in vec3 normal;
in vec2 uv;
in float occlusion;

layout(location = 0) out vec4 out_albedo;
layout(location = 1) out vec4 out_relief;  // slopes to the right and up, depth, and the part of the sky that is seen

#include "cutout.glsl"
#include "normal_map.glsl"
#include "slopes.glsl"

void main() {
    vec4 color = textureLod(color_map, uv, 0.0) * base_color;
    float depth = (turn * position).z;
    if (cut_out(color.a) || depth < slab.x || depth >= slab.y) discard;
    float side = gl_FrontFacing ? -1.0 : 1.0;  // upside down, every winding is turned round
    float length_ = length(normal);  // 0 where the corners' normals cancel each other
    vec3 facing = length_ > 0.0 ? side * normal / length_ : transpose(turn)[2];
    if (has_normal_map) {
        vec3 bump = textureLod(normal_map, uv, 0.0).xyz * 2.0 - 1.0;
        facing = bumped(facing, side, bump, dFdx(position), dFdy(position), dFdx(uv), dFdy(uv));
    }
    out_albedo = vec4(color.rgb, 1.0);
    vec3 seen = turn * facing;
    vec2 slope = seen.xy / max(seen.z, 1e-3);
    slope *= min(1.0, STEEPEST / max(length(slope), 1e-6));
    out_relief = vec4(slope / STEEPEST * 0.5 + 0.5, (depth - range.x) / (range.y - range.x), occlusion);
}
#endif
