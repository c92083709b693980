#pragma once

#include "pipeline/sites.h"
#include "soundmap/v1/robot_service.grpc.pb.h"

namespace soundmap::api {

class RobotService : public v1::RobotService::CallbackService {
 public:
  explicit RobotService(pipeline::Sites* sites) : sites_(sites) {}

  grpc::ServerUnaryReactor* GetRobot(grpc::CallbackServerContext* context,
                                     const v1::GetRobotRequest* request,
                                     v1::Robot* response) override;
  grpc::ServerUnaryReactor* ListRobots(grpc::CallbackServerContext* context,
                                       const v1::ListRobotsRequest* request,
                                       v1::ListRobotsResponse* response) override;

 private:
  pipeline::Sites* const sites_;
};

}  // namespace soundmap::api
