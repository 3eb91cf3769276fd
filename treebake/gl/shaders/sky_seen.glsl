// Adds up, for every vertex of a mesh in a texel of its own, the sky that it sees along a direction and against it.
#ifdef VERTEX_STAGE
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
uniform sampler2D places;   // position, and 1 for what is seen and lit from both sides
uniform sampler2D normals;  // as light falls on them
uniform sampler2D planes;   // normals of the faces around
uniform sampler2D reach;    // what sky_depth.glsl drew
uniform mat3 turn;
uniform vec3 middle;
uniform float radius;
uniform float bias;  // over the radius

layout(location = 0) out vec2 out_seen;  // cosine of what is seen, cosine of all

const float STEEPEST = 8.0;  // a plane seen at a more grazing angle is taken for this steep

void main() {
    ivec2 vertex = ivec2(gl_FragCoord.xy);
    vec4 place = texelFetch(places, vertex, 0);
    vec3 at = turn * (place.xyz - middle) / radius;
    float cosine = (turn * texelFetch(normals, vertex, 0).xyz).z;
    vec2 weight = place.w > 0.5 ? vec2(abs(cosine)) : max(vec2(cosine, -cosine), 0.0);
    // A map tells the depth in the middle of its texels: there the vertex's own plane is nearer or farther than here.
    vec3 plane = turn * texelFetch(planes, vertex, 0).xyz;
    vec2 slope = -plane.xy * sign(plane.z) / max(abs(plane.z), 1e-6);
    slope *= min(1.0, STEEPEST / max(length(slope), 1e-6));
    ivec2 last = textureSize(reach, 0) - 1;
    vec2 texel = (at.xy * 0.5 + 0.5) * vec2(last + 1) - 0.5;
    vec2 part = fract(texel);
    vec2 seen = vec2(0.0);
    for (int corner = 0; corner < 4; ++corner) {
        ivec2 next = ivec2(corner & 1, corner >> 1);
        ivec2 there = ivec2(floor(texel)) + next;
        vec2 share = mix(1.0 - part, part, vec2(next));
        float along = at.z + dot(slope, (vec2(there) - texel) * 2.0 / vec2(last + 1));
        vec2 most = texelFetch(reach, clamp(there, ivec2(0), last), 0).xy;
        seen += share.x * share.y * step(most, vec2(along, -along) + bias);
    }
    out_seen = vec2(dot(weight, seen), weight.x + weight.y);
}
#endif
