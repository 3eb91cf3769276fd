// Averages blocks of factor x factor samples of two images; alpha becomes coverage and the rest is premultiplied by it.
#ifdef VERTEX_STAGE
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);  // one triangle over the window
    gl_Position = vec4(corner, 0.0, 1.0);
}
#endif

#ifdef FRAGMENT_STAGE
uniform sampler2D first;
uniform sampler2D second;
uniform int factor;
layout(location = 0) out vec4 out_first;
layout(location = 1) out vec4 out_second;

void main() {
    ivec2 origin = ivec2(gl_FragCoord.xy) * factor;
    vec4 sum_first = vec4(0.0);
    vec4 sum_second = vec4(0.0);
    for (int y = 0; y < factor; ++y) {
        for (int x = 0; x < factor; ++x) {
            sum_first += texelFetch(first, origin + ivec2(x, y), 0);
            sum_second += texelFetch(second, origin + ivec2(x, y), 0);
        }
    }
    out_first = sum_first / float(factor * factor);
    out_second = sum_second / float(factor * factor);
}
#endif
