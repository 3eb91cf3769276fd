#include "fade.glsl"

// Whether this fragment is left out of what is covered in part and must be drawn solid: as many are drawn as its alpha
// says, and others of each triangle, so that what lies behind each other covers more together.
bool dithered(float alpha) {
    uint which = uint(gl_FragCoord.x) ^ uint(gl_FragCoord.y) << 16 ^ uint(gl_PrimitiveID) * 0x85EBCA77u;
    return faded(which, alpha);
}
