#pragma once

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/sound_map_service.grpc.pb.h"
#include "storage/store.h"

namespace soundmap::api {

class SoundMapService : public v1::SoundMapService::CallbackService {
 public:
  SoundMapService(pipeline::Sites* sites, Access* access, const storage::Store* store)
      : sites_(sites), access_(access), store_(store) {}

  grpc::ServerUnaryReactor* GetSoundSource(grpc::CallbackServerContext* context,
                                           const v1::GetSoundSourceRequest* request,
                                           v1::SoundSource* response) override;
  grpc::ServerUnaryReactor* ListSoundSources(grpc::CallbackServerContext* context,
                                             const v1::ListSoundSourcesRequest* request,
                                             v1::ListSoundSourcesResponse* response) override;
  grpc::ServerWriteReactor<v1::VoxelChunk>* QueryVoxels(
      grpc::CallbackServerContext* context, const v1::QueryVoxelsRequest* request) override;
  grpc::ServerUnaryReactor* ListAudioScans(grpc::CallbackServerContext* context,
                                           const v1::ListAudioScansRequest* request,
                                           v1::ListAudioScansResponse* response) override;

 private:
  pipeline::Sites* const sites_;
  Access* const access_;
  const storage::Store* const store_;
};

}  // namespace soundmap::api
