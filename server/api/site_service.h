#pragma once

#include "pipeline/sites.h"
#include "soundmap/v1/site_service.grpc.pb.h"

namespace soundmap::api {

class SiteService : public v1::SiteService::CallbackService {
 public:
  explicit SiteService(pipeline::Sites* sites) : sites_(sites) {}

  grpc::ServerUnaryReactor* CreateSite(grpc::CallbackServerContext* context,
                                       const v1::CreateSiteRequest* request,
                                       v1::Site* response) override;
  grpc::ServerUnaryReactor* GetSite(grpc::CallbackServerContext* context,
                                    const v1::GetSiteRequest* request, v1::Site* response) override;
  grpc::ServerUnaryReactor* ListSites(grpc::CallbackServerContext* context,
                                      const v1::ListSitesRequest* request,
                                      v1::ListSitesResponse* response) override;
  grpc::ServerUnaryReactor* DeleteSite(grpc::CallbackServerContext* context,
                                       const v1::DeleteSiteRequest* request,
                                       v1::DeleteSiteResponse* response) override;

 private:
  pipeline::Sites* const sites_;
};

}  // namespace soundmap::api
