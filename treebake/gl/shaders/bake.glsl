// Draws flattened leaves straight into the atlas: position is in texels, row 0 first.
#ifdef VERTEX_STAGE
in vec3 in_position;  // atlas x and y in texels, depth between -1 and 1 (greatest in front)
in vec2 in_uv;
in vec3 in_normal;  // the source's normal in the card's frame (right, up, towards the viewer)
in float in_value;
uniform vec4 window;  // the part of the atlas that this tile shows: x, y, width, height in texels
out vec2 uv;
out vec3 normal;
out float value;

void main() {
    vec2 place = (in_position.xy - window.xy) / window.zw * 2.0 - 1.0;
    gl_Position = vec4(place, -in_position.z, 1.0);
    uv = in_uv;
    normal = in_normal;
    value = in_value;
}
#endif

#ifdef FRAGMENT_STAGE
in vec2 uv;
in vec3 normal;
in float value;
uniform sampler2D color_map;
uniform sampler2D normal_map;
uniform bool has_normal_map;
uniform vec4 base_color;
layout(location = 0) out vec4 out_color;
layout(location = 1) out vec4 out_normal;  // with the value in place of alpha

#include "normal_map.glsl"
#include "cutout.glsl"

void main() {
    // Unfiltered, as if the leaf were modelled: mips thin what is cut out and mix in what lies under it.
    vec4 color = textureLod(color_map, uv, 0.0) * base_color;
    if (cut_out(color.a)) discard;
    // Rows run downwards in the atlas and upwards in GL's window, which turns every winding round.
    float side = gl_FrontFacing ? -1.0 : 1.0;
    float length_ = length(normal);  // 0 where the corners' normals cancel each other
    vec3 facing = length_ > 0.0 ? side * normal / length_ : vec3(0.0, 0.0, 1.0);
    if (has_normal_map) {
        vec3 bump = textureLod(normal_map, uv, 0.0).xyz * 2.0 - 1.0;
        facing = bumped(facing, side, bump, vec3(1.0, 0.0, 0.0), vec3(0.0, -1.0, 0.0), dFdx(uv), dFdy(uv));
    }
    out_color = vec4(color.rgb, 1.0);
    out_normal = vec4(facing, value);
}
#endif
