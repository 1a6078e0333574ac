/* Prints the newest light of a running daemon whenever it changes. Links libpenumbra_client. */
#include <penumbra/client/penumbra_client.h>
#include <stdio.h>

int main(int count, char** arguments) {
  penumbra_client* client = NULL;
  int code = penumbra_client_open(count > 1 ? arguments[1] : NULL, &client);
  if (client == NULL) {
    fprintf(stderr, "client_light: %s\n", penumbra_error_text(code));
    return 1;
  }
  if (code < 0) /* no daemon yet: the wait below passes until it runs */
    fprintf(stderr, "%s: %s\n", penumbra_client_path(client), penumbra_error_text(code));

  struct penumbra_light light;
  light.number = 0;
  while ((code = penumbra_client_wait(client, light.number, -1, &light)) >= 0) {
    printf("light %llu, %.1f ms old, mean radiance %.3f %.3f %.3f\n",
           (unsigned long long)light.number, (double)penumbra_light_age_ns(&light) / 1e6,
           (double)light.mean_radiance[0], (double)light.mean_radiance[1],
           (double)light.mean_radiance[2]);
    for (unsigned i = 0; i < light.light_count; ++i) {
      const float* towards = light.lights[i].direction;
      printf("  light %u towards %.2f %.2f %.2f\n", (unsigned)light.lights[i].id,
             (double)towards[0], (double)towards[1], (double)towards[2]);
    }
    fflush(stdout);
  }
  fprintf(stderr, "%s: %s\n", penumbra_client_path(client), penumbra_error_text(code));
  penumbra_client_close(client);
  return 1;
}
