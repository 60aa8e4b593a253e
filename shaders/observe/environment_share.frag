// A node of an environment that is not all the light of a view: relative to the irradiance of all of it.
uniform sampler2D u_nodes;        // as observe/environment_nodes.frag leaves them
uniform sampler2D u_environment;  // irradiance of the environment
uniform sampler2D u_irradiance;   // of the environment and the view's lights
#ifdef BOUNCED
uniform sampler2D u_bounced;      // indirect irradiance
#endif
uniform ivec2 u_corner;           // of the node's place

layout(location = 0) out vec4 o_node;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy), at = here - u_corner;
    vec3 all = texelFetch(u_irradiance, at, 0).rgb;
#ifdef BOUNCED
    all += texelFetch(u_bounced, at, 0).rgb;
#endif
    vec4 node = texelFetch(u_nodes, here, 0);
    o_node = vec4(node.rgb * texelFetch(u_environment, at, 0).rgb / max(all, vec3(1e-20)), node.a);
}
