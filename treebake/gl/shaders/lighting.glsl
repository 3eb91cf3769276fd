// Lambert under a sun and a two-colour sky, which stand still in the world ([GPSS07] 5.2). As SHADED, with what takes
// light away and lets it through: shadows, the occluded sky, transmission. As CASTER nothing is lit: depth is all.
layout(std140) uniform Light {
    mat4 to_shadow;      // from the world to the shadow map: texture coordinates and depth, times w
    vec3 sun_direction;  // towards it
    float texel;         // the longer side of a texel of the shadow map where w is one, in the world's unit
    vec3 sun;
    float occluded;      // 1, or 0 where the sky is seen whole from everywhere
    vec3 sky;
    vec3 ground;
};

struct Surface {
    vec3 albedo;
    vec3 normal;  // on the viewer's side
    vec3 point;   // in the world
    float seen;   // the part of the sky that it sees
    bool thin;    // a leaf, through which light comes
};

// How gently the sun fades where many surfaces share a mean normal. FLIP over floor of a chestnut at 256, 128 and 64
// pixels, exposures fitted:         slicings           views
// 0                            1.014 0.915 0.861  1.356 1.117 0.986
// 0.4                          0.988 0.862 0.795  1.277 1.010 0.878
// 0.6                          0.998 0.860 0.781  1.259 0.979 0.842
// each sample lit by itself    0.989 0.860 0.779  1.244 0.966 0.837
const float SUN_SOFTNESS = 0.5;

#ifdef SHADED
uniform sampler2DShadow shadow_map;
uniform float vague;        // how far the depths of what is drawn are off, in the tree's unit: 0 but for pictures
uniform vec4 transmission;  // factors on the albedo for what goes through, and which part of the light that is

const float STEEPEST_LEAN = 16.0;  // tangent of the angle to the sun up to which a surface does not shade itself

// The part of the sun that shines on a point whose normal makes an angle of this cosine with it. The point is moved
// towards the sun by as much as its surface's depth changes within the four texels that are filtered, which lie up to
// sqrt(2) apart; a texel grows with w across the view and with its square along it.
float sunlit(vec3 point, float cosine) {
    float lean = min(sqrt(max(1.0 - cosine * cosine, 0.0)) / max(abs(cosine), 1e-3), STEEPEST_LEAN);
    float w = (to_shadow * vec4(point, 1.0)).w;
    float away = vague + texel * max(w, w * w) * (1.0 + 1.5 * lean);
    vec4 at = to_shadow * vec4(point + sun_direction * away, 1.0);
    return texture(shadow_map, at.xyz / at.w);
}
#endif

// front, back: cosines by which the sun shines on the viewer's side and on the other.
vec3 lit_by(Surface surface, float front, float back) {
#ifdef CASTER
    return vec3(0.0);
#else
    vec3 above = mix(ground, sky, 0.5 + 0.5 * surface.normal.y);
#ifdef SHADED
    vec3 below = mix(ground, sky, 0.5 - 0.5 * surface.normal.y);
    float shade = sunlit(surface.point, front - back);
    float seen = mix(1.0, surface.seen, occluded);
    float through = surface.thin ? transmission.a : 0.0;
    vec3 light = (1.0 - through) * (sun * (shade * front) + above * seen)
               + through * transmission.rgb * (sun * (shade * back) + below * seen);
#else
    vec3 light = sun * front + above;
#endif
    return min(surface.albedo * light, 1.0);  // clipped before samples are averaged, as in a client that draws into 8 bits
#endif
}

// The light that a surface sends back. Its normal is of length 1.
vec3 lit(Surface surface) {
    float cosine = dot(surface.normal, sun_direction);
    return lit_by(surface, max(cosine, 0.0), max(-cosine, 0.0));
}

// The same of many surfaces with this mean albedo and normal, of any length: some face the sun where their mean is
// turned from it, so the mean of their light is softer than the light of their mean.
vec3 lit_softly(Surface surface) {
    surface.normal /= max(length(surface.normal), 1e-6);
    float cosine = dot(surface.normal, sun_direction);
    float soft = sqrt(cosine * cosine + SUN_SOFTNESS * SUN_SOFTNESS);
    return lit_by(surface, 0.5 * (soft + cosine), 0.5 * (soft - cosine));
}
