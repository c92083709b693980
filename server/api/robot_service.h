#pragma once

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/robot_service.grpc.pb.h"

namespace soundmap::api {

class RobotService : public v1::RobotService::CallbackService {
 public:
  RobotService(pipeline::Sites* sites, Access* access) : sites_(sites), access_(access) {}

  grpc::ServerUnaryReactor* GetRobot(grpc::CallbackServerContext* context,
                                     const v1::GetRobotRequest* request,
                                     v1::Robot* response) override;
  grpc::ServerUnaryReactor* ListRobots(grpc::CallbackServerContext* context,
                                       const v1::ListRobotsRequest* request,
                                       v1::ListRobotsResponse* response) override;

 private:
  pipeline::Sites* const sites_;
  Access* const access_;
};

}  // namespace soundmap::api
