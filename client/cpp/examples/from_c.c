/* One character through the C interface, as a game engine would use it: from_c [HOST:PORT] */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "motiongen/motiongen.h"

static int failed(const motiongen_error* error) {
  fprintf(stderr, "%s: %s\n", error->reason, error->message);
  return 1;
}

/* a slope of 6 degrees, uphill in the walking direction */
static double slope(void* context, double x_m, double z_m) {
  (void)context;
  (void)x_m;
  return 0.1 * z_m;
}

int main(int argc, char** argv) {
  motiongen_error error = {.struct_size = sizeof error};
  motiongen_client_options options;
  motiongen_session_options character;
  motiongen_client* client = NULL;
  motiongen_session* walker = NULL;
  motiongen_rig rig = {.struct_size = sizeof rig};
  motiongen_clip_options wanted;
  motiongen_waypoint goal;
  motiongen_clip* clip = NULL;
  motiongen_residual residual;
  motiongen_ground* ground = NULL;
  uint64_t frame;
  float* row;

  if (motiongen_abi_version() != MOTIONGEN_ABI_VERSION) return 1;
  memset(&options, 0, sizeof options);
  options.struct_size = sizeof options;
  options.address = argc > 1 ? argv[1] : "localhost:50051";
  if (motiongen_client_connect(&options, &client, &error) != MOTIONGEN_OK) return failed(&error);

  memset(&character, 0, sizeof character);
  character.struct_size = sizeof character;
  character.prompt = "a person walks forward";
  character.manual_clock = 1; /* frame by frame, as fast as frames come */
  if (motiongen_client_open(client, &character, &walker, &error) != MOTIONGEN_OK) return failed(&error);
  if (motiongen_session_wait_open(walker, 30.0, &error) != MOTIONGEN_OK) return failed(&error);
  if (motiongen_session_rig(walker, &rig, &error) != MOTIONGEN_OK) return failed(&error);
  printf("%u joints, the root is %s\n", rig.num_joints, motiongen_session_joint_name(walker, 0));

  if (motiongen_ground_create(walker, slope, NULL, &ground, &error) != MOTIONGEN_OK) return failed(&error);
  row = malloc(rig.row_floats * sizeof *row);
  if (row == NULL) return 1;
  for (frame = 0; frame < 40; ++frame) {
    if (motiongen_session_wait_frame(walker, frame, 30.0, &error) != MOTIONGEN_OK) return failed(&error);
    if (motiongen_session_advance_to(walker, frame, &error) != MOTIONGEN_OK) return failed(&error);
    if (!motiongen_session_sample_on_ground(walker, ground, row, rig.row_floats, &error)) return failed(&error);
    if (frame % 10 == 0) {
      const float* hips = row + rig.root_column;
      printf("frame %u: the hips are at %.2f, %.2f, %.2f m\n", (unsigned)frame, (double)hips[0], (double)hips[1],
             (double)hips[2]);
    }
  }
  free(row);
  motiongen_ground_destroy(ground);

  memset(&wanted, 0, sizeof wanted);
  wanted.struct_size = sizeof wanted;
  wanted.num_frames = 60;
  wanted.prompt = "a person walks forward";
  memset(&goal, 0, sizeof goal);
  goal.frame = 50;
  goal.z_m = 2.0F;
  wanted.waypoints = &goal;
  wanted.num_waypoints = 1;
  residual.struct_size = sizeof residual;
  if (motiongen_client_generate_clip(client, &wanted, &clip, &error) != MOTIONGEN_OK) return failed(&error);
  if (motiongen_clip_residual(clip, 0, 0, &residual, &error) != MOTIONGEN_OK) return failed(&error);
  printf("a clip of %u frames: %.2f m from its waypoint\n", motiongen_clip_num_frames(clip),
         (double)residual.position_m);
  motiongen_clip_destroy(clip);
  motiongen_session_destroy(walker);
  motiongen_client_destroy(client);
  return 0;
}
