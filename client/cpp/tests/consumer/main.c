/* Uses the C interface from outside of the tree. */
#include <stdio.h>
#include <string.h>

#include "motiongen/motiongen.h"

int main(void) {
  motiongen_client_options options;
  motiongen_client* client = NULL;
  motiongen_error error;
  memset(&options, 0, sizeof options);
  memset(&error, 0, sizeof error);
  options.struct_size = sizeof options;
  error.struct_size = sizeof error;
  options.address = "nowhere";
  if (motiongen_client_connect(&options, &client, &error) != MOTIONGEN_INVALID_ARGUMENT) return 1;
  printf("%u: %s\n", motiongen_abi_version(), error.message);
  return client == NULL ? 0 : 1;
}
